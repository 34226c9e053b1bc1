"""How much memory this machine has left for new processes."""

from pathlib import Path

from mpi4py import MPI

from pdpetsc.errors import NoRoom

GIB = 2.0**30

SYSTEM = Path("/")
"""Where /proc and /sys are found."""


def available_memory() -> float | None:
    """Bytes that this process and its like can still take on this machine; None where the system does not say.

    What Linux calls available, or what the process's control group leaves where that is less (as in containers and
    batch jobs); the group's cache of files, which gives way, does not count as used.
    """
    found = [amount for amount in (_of_machine(), *map(_of_group, _groups())) if amount is not None]
    return min(found, default=None)


def check_room(place: str, what: str, number: float, each: float) -> None:
    """Refuse to make arrays that this machine has no room for.

    Args:
        place: of what is wrong in the case.
        what: the things that there are so many of.
        number: of them.
        each: bytes of one.

    Raises:
        NoRoom: there is no room.
    """
    available = available_memory() if number * each > GIB else None
    if available is not None and number * each > available:
        free = f"{available / GIB:.2g} GiB that are free"
        raise NoRoom(f"{place}: makes {number:.3g} {what} at once, too many for the {free}")


def memory_per_rank(comm: MPI.Comm) -> float | None:
    """The least that any rank has when those on a machine share what is available there [byte] (collective)."""
    node = comm.Split_type(MPI.COMM_TYPE_SHARED)
    amount = available_memory()
    share = float("inf") if amount is None else amount / node.size
    node.Free()
    least = comm.allreduce(share, MPI.MIN)
    return None if least == float("inf") else least


def _of_machine() -> float | None:
    for line in _text(SYSTEM / "proc/meminfo").splitlines():
        if line.startswith("MemAvailable:"):
            return 1024.0 * int(line.split()[1])
    return None


def _groups() -> list[tuple[Path, str, str]]:
    """Folder of each control group that may limit this process, and its files of limit and use."""
    groups = []
    for line in _text(SYSTEM / "proc/self/cgroup").splitlines():
        _, kinds, path = line.split(":", 2)
        if kinds == "":
            root, files = SYSTEM / "sys/fs/cgroup", ("memory.max", "memory.current")
        elif "memory" in kinds.split(","):
            root, files = SYSTEM / "sys/fs/cgroup/memory", ("memory.limit_in_bytes", "memory.usage_in_bytes")
        else:
            continue
        folder = root / path.strip("/")
        groups += [(parent, *files) for parent in (folder, *folder.parents) if parent.is_relative_to(root)]
    return groups


def _of_group(group: tuple[Path, str, str]) -> float | None:
    folder, limit, used = group
    numbers = [_text(folder / name).strip() for name in (limit, used)]
    if not all(number.isdigit() for number in numbers):
        return None  # no such file, or "max": no limit
    cache = [int(line.split()[1]) for line in _text(folder / "memory.stat").splitlines() if "inactive_file" in line]
    return float(max(0, int(numbers[0]) - int(numbers[1]) + max(cache, default=0)))


def _text(path: Path) -> str:
    try:
        return path.read_text()
    except OSError:
        return ""
