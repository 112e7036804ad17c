"""Connections to learners and servers: addresses, certificates, tokens and the errors of calls."""

import contextlib
import dataclasses
import ipaddress
import os
import pathlib
import ssl
import time
import urllib.parse
from collections.abc import Iterator, Sequence
from typing import Any

import grpc

from s2mia.name import printable
from s2mia.settings import text_of

CALL_SECS = 10.0
# Interval at which a server that is starting is tried again.
RETRY_SECS = 0.2
TOKEN = "S2MIA_TOKEN"
_OPTIONS = [
    # The address is used as it is given, as the program does: http_proxy and its relatives have no effect.
    ("grpc.enable_http_proxy", 0),
    # Channels share no connection: a registration ends with its connection, and a connection has at most 16 streams.
    ("grpc.use_local_subchannel_pool", 1),
    # A learner that requires TLS closes a plain connection before the call, which gRPC would repeat until the deadline.
    ("grpc.enable_retries", 0),
    # A call to a machine that no longer answers ends within 30 s, however long its deadline is.
    ("grpc.keepalive_time_ms", 20_000),
    ("grpc.keepalive_timeout_ms", 10_000),
    ("grpc.http2.ping_timeout_ms", 10_000),
    ("grpc.http2.max_pings_without_data", 0),
]


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


class CallError(ConnectionError, grpc.RpcError):  # type: ignore[misc]  # grpc has no types
    """A call that failed: one line with the address, the gRPC status and its details. Also an `RpcError`, as gRPC raises."""

    def __init__(self, address: str, status: grpc.RpcError) -> None:
        known = isinstance(status, grpc.Call)
        self.status: grpc.RpcError = status
        """The error that gRPC raised; `grpc_status.rpc_status.from_call` reads the refusal in it."""
        self._code: grpc.StatusCode = status.code() if known else grpc.StatusCode.UNKNOWN
        self._details = printable(str(status.details() if known else status))
        super().__init__(f"{address}: {self._code.name}: {self._details}{_advice(self._code, self._details)}")

    def code(self) -> grpc.StatusCode:
        """The gRPC status."""
        return self._code

    def details(self) -> str:
        """What the server says, in one line."""
        return self._details


def _advice(code: grpc.StatusCode, details: str) -> str:
    """What to change, if the details do not say it."""
    if code == grpc.StatusCode.UNIMPLEMENTED and not details:
        return "the server at this address does not provide this service; it may be another program"
    if "failed to connect" in details and "Socket closed" in details:
        return "; if the server requires TLS, use https:// and tls=s2mia.Tls(ca, certificate, key)"
    if "WRONG_VERSION_NUMBER" in details:
        return "; the server has no TLS: use http://"
    return ""


def target(address: str, tls: Tls | None, *, insecure_allow_remote: bool = False) -> str:
    """`HOST:PORT` of an address: `HOST:PORT`, `http://HOST:PORT`, or with `tls` `https://HOST:PORT`.

    Raises `ValueError` if the address is invalid, contradicts `tls`, or needs TLS.
    """
    scheme, host, port = _parts(address)
    if scheme == "https" and tls is None:
        raise ValueError(f"{address}: https:// needs tls=s2mia.Tls(ca, certificate, key)")
    if scheme == "http" and tls is not None:
        raise ValueError(f"{address}: with tls, the URL begins with https://")
    if tls is None and not insecure_allow_remote and not _is_loopback(host):
        raise ValueError(f"{address}: plain text to another machine needs tls or insecure_allow_remote=True")
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def _parts(address: str) -> tuple[str, str, int]:
    """Scheme, host and port of an address; the scheme may be empty."""
    address = text_of("address", address, "HOST:PORT or a URL")
    try:
        parts = urllib.parse.urlsplit(address if "://" in address else f"//{address}")
        host = parts.hostname
    except ValueError:
        host = None
    port = host and parts.netloc.rpartition(":")[2]
    if host and port and port.isascii() and port.isdigit() and int(port) > 65535:
        raise ValueError(f"{address}: the port {port} is not a number from 0 to 65535")
    more = host and (parts.path.strip("/"), parts.query, parts.fragment, "@" in parts.netloc)
    if not host or any(more or ()) or parts.scheme not in ("", "http", "https") or not _is_port(port):
        raise ValueError(f"{address}: expected HOST:PORT, http://HOST:PORT or https://HOST:PORT")
    return parts.scheme, host, int(port or "")


def _is_port(text: str | None) -> bool:
    return text is not None and text.isascii() and text.isdigit()


def _is_loopback(host: str) -> bool:
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return host.lower() == "localhost"
    mapped = address.ipv4_mapped if isinstance(address, ipaddress.IPv6Address) else None
    return (mapped or address).is_loopback


def authorization(address: str, tls: Tls | None, token: str | None) -> list[tuple[str, str]] | None:
    """Metadata of every call: the run's token, by default that of S2MIA_TOKEN. `None` if neither is there.

    Plain text to another machine would show the token to the network: that of S2MIA_TOKEN is not sent there.
    Raises `ValueError` for such a `token`, and for one that no header can contain.
    """
    if not isinstance(token, str | None):
        raise ValueError(f"token has the type {type(token).__name__}; it is a text")
    if tls is None and not _is_loopback(_parts(address)[1]):
        if token:
            raise ValueError(f"{address}: the token would be readable in the network; use tls")
        return None
    source, token = ("the token", token) if token else (TOKEN, os.environ.get(TOKEN))
    if not token:
        return None
    if not (token.strip().isascii() and token.strip().isprintable()):
        raise ValueError(f"{source} contains a character that a header cannot have")
    return [("authorization", f"Bearer {token.strip()}")]


def open_channel(
    address: str,
    tls: Tls | None = None,
    *,
    insecure_allow_remote: bool = False,
    options: Sequence[tuple[str, int | str]] = (),
) -> grpc.Channel:
    """A channel to `address`, without a proxy.

    Raises `ValueError` as `target` and for an invalid certificate or key, and `OSError` for a file that cannot be read.
    """
    if not isinstance(tls, Tls | None):
        raise ValueError(f"tls is {tls!r}; it is s2mia.Tls(ca, certificate, key)")
    place = target(address, tls, insecure_allow_remote=insecure_allow_remote)
    if tls is None:
        return grpc.insecure_channel(place, options=[*_OPTIONS, *options])
    ca, certificate, key = (pathlib.Path(path).read_bytes() for path in (tls.ca, tls.certificate, tls.key))
    _demand_valid(tls)
    name = [("grpc.ssl_target_name_override", tls.server_name)] if tls.server_name else []
    credentials = grpc.ssl_channel_credentials(ca, key, certificate)
    return grpc.secure_channel(place, credentials, options=[*_OPTIONS, *options, *name])


def _demand_valid(tls: Tls) -> None:
    """Refuses files that are no certificates, or a key of another certificate; gRPC would not name them."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    try:
        context.load_verify_locations(cafile=tls.ca)
    except ssl.SSLError as error:
        raise ValueError(f"{tls.ca} is no valid certificate authority: {error.reason or error}") from None
    try:
        # Without this password, an encrypted key would be asked for in the terminal.
        context.load_cert_chain(tls.certificate, tls.key, password="")
    except ssl.SSLError as error:
        pair = f"{tls.certificate} and {tls.key}"
        raise ValueError(f"{pair} are no certificate and its key: {error.reason or error}") from None


class Connection:
    """A channel to `address` and the service of `stub` on it, whose failed calls are `CallError`s."""

    def __init__(
        self,
        address: str,
        stub: Any,
        tls: Tls | None,
        *,
        insecure_allow_remote: bool,
        token: str | None = None,
        options: Sequence[tuple[str, int | str]] = (),
    ) -> None:
        self.address = address
        self.channel = open_channel(address, tls, insecure_allow_remote=insecure_allow_remote, options=options)
        self.metadata = authorization(address, tls, token)
        self.service = stub(self.channel)
        self._open = True

    @contextlib.contextmanager
    def errors(self) -> Iterator[None]:
        """Turns a failed call into a `CallError`."""
        if not self._open:
            raise ConnectionError(f"{self.address}: the connection is closed")
        try:
            yield
        except CallError:
            raise
        except grpc.RpcError as error:
            raise CallError(self.address, error) from None
        except ValueError as error:
            if self._open and "closed" not in str(error):
                raise
            # Another thread closed the channel.
            raise ConnectionError(f"{self.address}: the connection is closed") from None

    def call(self, name: str, request: Any, timeout: float = CALL_SECS) -> Any:
        """The answer to one request, or the stream of answers."""
        with self.errors():
            return getattr(self.service, name)(request, timeout=timeout, metadata=self.metadata)

    def first_call(self, name: str, request: Any) -> Any:
        """The answer to one request. A server that is starting has `CALL_SECS` until it accepts connections."""
        with self.errors():
            end = time.monotonic() + CALL_SECS
            while True:
                try:
                    return getattr(self.service, name)(request, timeout=CALL_SECS, metadata=self.metadata)
                except grpc.RpcError as error:
                    # With `wait_for_ready`, the status would not have the reason why there is no connection.
                    refused = error.code() == grpc.StatusCode.UNAVAILABLE and "refused" in str(error.details())
                    if not refused or time.monotonic() > end:
                        raise
                time.sleep(RETRY_SECS)

    def close(self) -> None:
        """Closes the channel."""
        self._open = False
        self.channel.close()
