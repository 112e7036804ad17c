"""Connections to learners and servers: addresses and certificates."""

import contextlib
import dataclasses
import ipaddress
import os
import pathlib
import urllib.parse
from collections.abc import Iterator, Sequence

import grpc

from s2mia.name import printable


@dataclasses.dataclass(frozen=True)
class Tls:
    """Paths of a client's PEM files, such as `s2mia certs` creates."""

    ca: str | pathlib.Path
    """Certificate authority that signed the learner's certificate."""
    certificate: str | pathlib.Path
    """The client's certificate; its role defines which requests are permitted."""
    key: str | pathlib.Path
    """Private key of `certificate`."""
    server_name: str | None = None
    """Host name in the learner's certificate; by default the host in its URL."""


def target(address: str, tls: Tls | None, *, insecure_allow_remote: bool = False) -> str:
    """`HOST:PORT` of an address: `HOST:PORT`, `http://HOST:PORT`, or with `tls` `https://HOST:PORT`.

    Raises `ValueError` if the address is invalid, contradicts `tls`, or needs TLS.
    """
    parts = urllib.parse.urlsplit(address if "://" in address else f"//{address}")
    try:
        host, port = parts.hostname, parts.port
    except ValueError:
        host, port = None, None
    if not host or port is None or parts.scheme not in ("", "http", "https") or parts.path.strip("/"):
        raise ValueError(f"{address}: expected HOST:PORT, http://HOST:PORT or https://HOST:PORT")
    if parts.scheme == "https" and tls is None:
        raise ValueError(f"{address}: https:// needs tls=s2mia.Tls(ca, certificate, key)")
    if parts.scheme == "http" and tls is not None:
        raise ValueError(f"{address}: with tls, the URL begins with https://")
    if tls is None and not insecure_allow_remote and not _is_loopback(host):
        raise ValueError(f"{address}: plain text to another machine needs tls or insecure_allow_remote=True")
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def authorization(token: str | None) -> list[tuple[str, str]] | None:
    """Metadata of every call: the run's token, by default that of S2MIA_TOKEN. `None` if neither is there."""
    token = token or os.environ.get("S2MIA_TOKEN")
    return [("authorization", f"Bearer {token.strip()}")] if token else None


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host.lower() == "localhost"


def open_channel(
    address: str,
    tls: Tls | None = None,
    *,
    insecure_allow_remote: bool = False,
    options: Sequence[tuple[str, int | str]] = (),
) -> grpc.Channel:
    """A channel to `address`. Raises `ValueError` as `target`, and `OSError` for a file that cannot be read."""
    place = target(address, tls, insecure_allow_remote=insecure_allow_remote)
    if tls is None:
        return grpc.insecure_channel(place, options=options)
    ca, certificate, key = (pathlib.Path(path).read_bytes() for path in (tls.ca, tls.certificate, tls.key))
    name = [("grpc.ssl_target_name_override", tls.server_name)] if tls.server_name else []
    credentials = grpc.ssl_channel_credentials(ca, key, certificate)
    return grpc.secure_channel(place, credentials, options=[*options, *name])


@contextlib.contextmanager
def one_line(address: str) -> Iterator[None]:
    """Turns a failed call into a `ConnectionError` of one line."""
    try:
        yield
    except grpc.RpcError as error:
        details = printable(str(error.details()))
        raise ConnectionError(f"{address}: {error.code().name}: {details}") from None
