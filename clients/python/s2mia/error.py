"""The error of runs."""


class RunError(ValueError):
    """A run that failed, or a run folder or checkpoint that cannot be used; one line with the reason."""
