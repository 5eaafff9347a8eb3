"""Every file can be imported on Windows and macOS: what they lack is looked up where it is used."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FILES = sorted(
    path
    for name in ("src", "tests", "benchmarks", "scripts", "examples")
    for path in (ROOT / name).rglob("*.py")
)
UNIX = {"resource", "pty", "tty", "termios", "fcntl", "pwd", "grp", "syslog", "posix", "readline"}
UNIX |= {"crypt", "spwd", "nis", "curses", "multiprocessing.popen_fork"}
# Of `os`, `signal` and `socket`; pthread_* and sched_* besides
ATTRIBUTES = {
    "os": """fork forkpty getuid geteuid getgid getegid getgroups setuid seteuid setgid setegid
        setreuid setregid setresuid setresgid getresuid getresgid setgroups initgroups killpg
        getpgid setpgid getpgrp setpgrp getsid setsid mkfifo mknod chroot chown fchown lchown
        lchmod chflags wait3 wait4 waitid WNOHANG nice getpriority setpriority uname sysconf
        confstr pathconf getloadavg openpty ctermid ttyname statvfs fstatvfs getxattr setxattr
        sendfile posix_spawn pread pwrite memfd_create O_NOFOLLOW O_DIRECTORY O_CLOEXEC
        O_NONBLOCK O_SYNC O_PATH O_TMPFILE""",
    "signal": """SIGKILL SIGALRM SIGHUP SIGQUIT SIGUSR1 SIGUSR2 SIGCHLD SIGPIPE SIGSTOP SIGCONT
        SIGTSTP SIGTTIN SIGTTOU SIGWINCH SIGXFSZ SIGXCPU alarm setitimer getitimer ITIMER_REAL
        pause sigwait siginterrupt""",
    "socket": "AF_UNIX AF_NETLINK AF_PACKET SO_REUSEPORT",
}
UNIX |= {f"{module}.{name}" for module, names in ATTRIBUTES.items() for name in names.split()}
FAMILIES = ("os.sched_", "signal.pthread_", "signal.SIGRT")


def is_unix(name: str) -> bool:
    return name in UNIX or name.startswith(FAMILIES)


def needed(node: ast.AST) -> Iterator[str]:
    """Full names that running a node needs for certain: nothing that it defines or guards."""
    match node:
        case ast.Import():
            yield from (alias.name for alias in node.names)
        case ast.ImportFrom(level=0):
            yield str(node.module)
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        case ast.Attribute(value=ast.Name(id=module)):
            yield f"{module}.{node.attr}"
    for child in certain(node):
        yield from needed(child)


def certain(node: ast.AST) -> Iterator[ast.AST]:
    """What runs whenever a node does."""
    match node:
        case ast.FunctionDef() | ast.AsyncFunctionDef():
            yield from (*node.decorator_list, *node.args.defaults)
            yield from (default for default in node.args.kw_defaults if default)
        case ast.Lambda():
            yield from node.args.defaults
        case ast.If() | ast.IfExp() | ast.While():
            yield node.test
        case ast.BoolOp():
            yield node.values[0]
        case ast.Try():
            yield from (*node.orelse, *node.finalbody)
        case _:
            yield from ast.iter_child_nodes(node)


def lacking(source: str) -> list[str]:
    return sorted({name for name in needed(ast.parse(source)) if is_unix(name)})


def test_every_file_can_be_imported_elsewhere():
    found = {path: lacking(path.read_text(encoding="utf-8")) for path in FILES}
    assert not {str(path.relative_to(ROOT)): names for path, names in found.items() if names}


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("import os, resource", ["resource"]),
        ("from os import mkfifo", ["os.mkfifo"]),
        ("import signal\ndef f(number=signal.SIGKILL): ...", ["signal.SIGKILL"]),
        ("@skipif(os.getuid() != 0)\ndef f(): ...", ["os.getuid"]),
        ("class A:\n    cores = len(os.sched_getaffinity(0))", ["os.sched_getaffinity"]),
        ("def f():\n    import pty\n    os.fork()", []),
        ("if sys.platform != 'win32':\n    import fcntl", []),
        ("try:\n    import fcntl\nexcept ImportError:\n    fcntl = None", []),
        ("root = hasattr(os, 'getuid') and os.getuid() == 0", []),
    ],
)
def test_what_is_guarded_or_used_later_is_left_alone(source: str, expected: list[str]):
    assert lacking(source) == expected
