"""Arrays from anybody's archive: nothing is inflated or unpickled, and nothing is unbounded."""

import io
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from tokenize import TokenError
from typing import Any
from zipfile import ZIP_STORED, BadZipFile, ZipFile, ZipInfo

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

Header = tuple[tuple[int, ...], np.dtype[Any]]  # shape and number type of one array

NUMBERS = "?iuf"  # kinds of numpy's types whose bytes are numbers and nothing else
LONGEST_HEADER = 4096  # bytes
READERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}


def read_arrays(
    path: Path, check: Callable[[Mapping[str, Header]], None] = lambda headers: None
) -> dict[str, NDArray[Any]]:
    """Arrays of a file that `numpy.savez` wrote, once `check` has let their headers pass.

    Every array is as long in memory as its bytes in the file, which are there: `savez` does not
    compress, and a header that claims more than its member holds is refused before it is read.
    """
    try:
        with ZipFile(path) as archive:
            members = {m.filename.removesuffix(".npy"): m for m in archive.infolist()}
            if len(members) < len(archive.infolist()):
                raise ValueError("two arrays have one name.")
            if sum(m.compress_size for m in members.values()) > path.stat().st_size:
                raise ValueError("its arrays claim more bytes than it has.")
            check({name: header(archive, member) for name, member in members.items()})
            return {name: content(archive, member) for name, member in members.items()}
    except (BadZipFile, RuntimeError, EOFError) as error:
        raise ValueError(f"{path.name}: is no whole archive of arrays ({error}).") from None
    except ValueError as error:
        raise ValueError(f"{path.name}: {error}") from None


def header(archive: ZipFile, member: ZipInfo) -> Header:
    """Shape and number type of a member, which must hold as many bytes as they say."""
    name = member.filename
    if member.compress_type != ZIP_STORED or member.compress_size != member.file_size:
        raise ValueError(f"{name!r} is compressed, which numpy.savez never does.")
    with archive.open(member) as file:
        start = io.BytesIO(file.read(LONGEST_HEADER))
    try:
        shape, _, dtype = READERS[npy.read_magic(start)](start)
    except (ValueError, KeyError, TypeError, SyntaxError, TokenError, RecursionError, MemoryError):
        raise ValueError(f"{name!r} does not start with the header of an array.") from None
    if dtype.kind not in NUMBERS:
        raise ValueError(f"{name!r} must hold plain numbers, got {dtype}.")
    claimed, held = math.prod(shape) * dtype.itemsize, member.file_size - start.tell()
    if claimed != held or min(shape, default=0) < 0:
        raise ValueError(f"{name!r} claims {claimed} bytes of numbers, but holds {held}.")
    return shape, dtype


def content(archive: ZipFile, member: ZipInfo) -> NDArray[Any]:
    """The array of a member whose header has been checked."""
    with archive.open(member) as file:
        array: NDArray[Any] = npy.read_array(file, allow_pickle=False)
        return array
