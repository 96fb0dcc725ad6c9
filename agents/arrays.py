"""Reader for arrays from untrusted archives: no decompression, no pickle, bounded memory."""

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

NUMBERS = "?iuf"  # kinds of numpy dtypes that hold plain numbers
LONGEST_HEADER = 4096  # bytes
READERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}


def read_arrays(
    path: Path, check: Callable[[Mapping[str, Header]], None] = lambda headers: None
) -> dict[str, NDArray[Any]]:
    """Read the arrays of a `numpy.savez` file; `check` may refuse their headers first.

    An array takes as much memory as its bytes in the file: compressed members are refused, and so
    is a header that claims more bytes than its member has.
    """
    try:
        with ZipFile(path) as archive:
            members = {m.filename.removesuffix(".npy"): m for m in archive.infolist()}
            if len(members) < len(archive.infolist()):
                raise ValueError("two arrays have the same name.")
            if sum(m.compress_size for m in members.values()) > path.stat().st_size:
                raise ValueError("the arrays claim more bytes than the file has.")
            check({name: header(archive, member) for name, member in members.items()})
            return {name: content(archive, member) for name, member in members.items()}
    except (BadZipFile, RuntimeError, EOFError) as error:
        raise ValueError(f"{path.name}: is not a complete archive of arrays ({error}).") from None
    except ValueError as error:
        raise ValueError(f"{path.name}: {error}") from None


def header(archive: ZipFile, member: ZipInfo) -> Header:
    """Shape and dtype of a member; refuses a member of another length than they imply."""
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
    claimed, actual = math.prod(shape) * dtype.itemsize, member.file_size - start.tell()
    if claimed != actual or min(shape, default=0) < 0:
        raise ValueError(f"{name!r} claims {claimed} bytes of numbers, but has {actual}.")
    return shape, dtype


def content(archive: ZipFile, member: ZipInfo) -> NDArray[Any]:
    """Read the array of a member whose header is checked."""
    with archive.open(member) as file:
        array: NDArray[Any] = npy.read_array(file, allow_pickle=False)
        return array
