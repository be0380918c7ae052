"""Runs a command under the restrictions of a systemd unit, as far as they need no service manager.

    python -m tests.confined UNIT COMMAND ...

In force: NoNewPrivileges, an empty CapabilityBoundingSet (where the caller may drop it), UMask,
MemoryDenyWriteExecute, SystemCallFilter with SystemCallErrorNumber, and RestrictAddressFamilies, on x86-64. Not in
force: what needs mounts, other users or control groups (ProtectSystem, PrivateTmp, DynamicUser, MemoryMax,
IPAddressDeny and the like).
"""

from __future__ import annotations

import ctypes
import errno
import os
import re
import socket
import struct
import subprocess
import sys
from pathlib import Path

NUMBERS = Path("/usr/include/x86_64-linux-gnu/asm/unistd_64.h")
_PR_SET_SECCOMP, _PR_CAPBSET_DROP, _PR_SET_NO_NEW_PRIVS, _PR_SET_MDWE = 22, 24, 38, 65
_FILTER_MODE, _ALLOW, _ERRNO, _X86_64 = 2, 0x7FFF0000, 0x00050000, 0xC000003E
_LOAD, _EQUALS, _RETURN = 0x20, 0x15, 0x06
_NUMBER_AT, _ARCHITECTURE_AT, _FIRST_ARGUMENT_AT = 0, 4, 16


def settings(unit: Path) -> dict[str, list[str]]:
    """The settings of a unit, each with its values in order."""
    found: dict[str, list[str]] = {}
    for name, value in re.findall(r"^([A-Za-z]+)=(.*)$", unit.read_text(), re.MULTILINE):
        found.setdefault(name, []).append(value)
    return found


def allowed_calls(filters: list[str]) -> set[str]:
    """The system calls that those values of SystemCallFilter allow."""
    calls: set[str] = set()
    for each in filters:
        named = set().union(*(_calls_of(group) for group in each.removeprefix("~").split()))
        calls = calls - named if each.startswith("~") else calls | named
    return calls


def _calls_of(group: str) -> set[str]:
    if not group.startswith("@"):
        return {group}
    done = subprocess.run(["systemd-analyze", "syscall-filter", group], capture_output=True, text=True, check=True)
    words = [line.strip() for line in done.stdout.splitlines()[1:]]
    return set().union(*(_calls_of(word) for word in words if word and not word.startswith("#")))


def program(calls: set[str], families: list[int], number_of: dict[str, int]) -> bytes:
    """A seccomp filter (struct sock_filter) that allows these calls, and sockets of these families."""

    def step(code: int, value: int, then: int = 0, otherwise: int = 0) -> bytes:
        return struct.pack("HBBI", code, then, otherwise, value)

    refused = step(_RETURN, _ERRNO | errno.EPERM)
    steps = [step(_LOAD, _ARCHITECTURE_AT), step(_EQUALS, _X86_64, 1, 0), refused, step(_LOAD, _NUMBER_AT)]
    for each in sorted(number_of[name] for name in calls & number_of.keys() if name != "socket"):
        steps += [step(_EQUALS, each, 0, 1), step(_RETURN, _ALLOW)]
    steps += [step(_EQUALS, number_of["socket"], 1, 0), refused, step(_LOAD, _FIRST_ARGUMENT_AT)]
    for family in families:
        steps += [step(_EQUALS, family, 0, 1), step(_RETURN, _ALLOW)]
    steps.append(step(_RETURN, _ERRNO | errno.EAFNOSUPPORT))
    return b"".join(steps)


def restrict(unit: Path) -> None:
    """Put this process under the restrictions of the unit."""
    given = settings(unit)
    number_of = {name: int(n) for name, n in re.findall(r"#define __NR_(\w+) (\d+)", NUMBERS.read_text())}
    families = [getattr(socket, name) for name in given["RestrictAddressFamilies"][0].split()]
    steps = program(allowed_calls(given["SystemCallFilter"]), families, number_of)
    os.umask(int(given["UMask"][0], 8))
    system = ctypes.CDLL(None, use_errno=True)
    for capability in range(64):
        system.prctl(_PR_CAPBSET_DROP, capability, 0, 0, 0)
    _require(system.prctl(_PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0), "no new privileges")
    _require(system.prctl(_PR_SET_MDWE, 1, 0, 0, 0), "no memory both written and run")
    held = ctypes.create_string_buffer(steps, len(steps))

    class Program(ctypes.Structure):
        _fields_ = (("length", ctypes.c_ushort), ("steps", ctypes.c_void_p))

    filtering = Program(len(steps) // 8, ctypes.addressof(held))
    _require(system.prctl(_PR_SET_SECCOMP, _FILTER_MODE, ctypes.byref(filtering), 0, 0), "the filter of system calls")


def _require(code: int, what: str) -> None:
    if code != 0:
        raise SystemExit(f"confined: expected {what}, got {os.strerror(ctypes.get_errno())}")


if __name__ == "__main__":
    restrict(Path(sys.argv[1]))
    os.execv(sys.argv[2], sys.argv[2:])
