"""The error of files that cannot be used."""


class RunError(ValueError):
    """A run folder, checkpoint or snapshot that cannot be used; one line with the file and the reason."""
