# SPDX-License-Identifier: Apache-2.0
"""Who may look and who may drive: the address the page was asked under, the page that asks, the token."""

import hmac
import ipaddress
import re
import secrets
import socket
from dataclasses import dataclass

LOOPBACK_NAMES = ("localhost", "127.0.0.1", "::1")
TOKEN_BYTES = 18
SHORTEST_TOKEN = 12  # characters
_HOST = re.compile(r"(?P<name>[a-z0-9.-]+|\[[0-9a-f:.]+\])(:(?P<port>\d{1,5}))?")


def is_loopback(host: str) -> bool:
    """Whether only programs of this machine reach this address."""
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return host == "localhost"


def new_token() -> str:
    """A token that nobody guesses."""
    return secrets.token_urlsafe(TOKEN_BYTES)


@dataclass(frozen=True)
class Access:
    """The rules of one server.

    Attributes:
        host: address it listens on.
        port: its port.
        token: must be shown with every request; "" asks for none.
    """

    host: str
    port: int
    token: str

    def knows_host(self, header: str) -> bool:
        """Whether a Host header names this server.

        A name that somebody else made to point at this machine (DNS rebinding) is none of ours, so that its pages
        cannot read this one.
        """
        parts = _HOST.fullmatch(header.lower())
        if parts is None or int(parts["port"] or 80) != self.port:
            return False
        name = parts["name"].strip("[]")
        if is_loopback(self.host):
            return name in LOOPBACK_NAMES or name == self.host.strip("[]")
        return name in LOOPBACK_NAMES or _is_address(name) or name in _own_names()

    def knows_origin(self, origin: str | None, host: str) -> bool:
        """Whether the page that opens a connection is the one served here; a browser always names it."""
        return origin is not None and self.knows_host(host) and origin.lower() == f"http://{host}".lower()

    def knows_token(self, *shown: str | None) -> bool:
        """Whether one of the tokens shown, in address or cookie, is the right one."""
        return not self.token or any(hmac.compare_digest(one.encode(), self.token.encode()) for one in shown if one)


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
        return True
    except ValueError:
        return False


def _own_names() -> set[str]:
    name = socket.gethostname().lower()
    return {name, name.partition(".")[0], f"{name.partition('.')[0]}.local", socket.getfqdn().lower()}
