"""The cache runs no foreign code, and damage to it is repaired."""

import os
import re
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dynamics import ARMS, Arm, compile_arm
from dynamics.cache import CacheWarning, cache_folder, kept, load, store
from tests.paths import ROOT

ARM = replace(ARMS["slim"], name="plain")
CANARY = 'open("canary", "w").close()'
HOSTILE = {
    "a statement behind a docstring": f'x."""\n{CANARY}\n"""',
    "a statement behind a literal": f"'\n{CANARY}\n'",
    "an escaped quote": f'\\"\n{CANARY}\n#',
    "a backslash at the end": "x\\",
    "an unknown character name": "\\N{x}",
    "three quotes": '"""',
    "NUL": "a\0b",
    "a lone surrogate": "a\ud800b",
    "a mark of the templates": "\n#steps\n#evaluate\n",
    "braces": "{0} {name!r} %s",
    "another line end": f"\u2028{CANARY}\r{CANARY}\x0c",
}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache, and a working directory where hostile code would leave a file."""
    monkeypatch.setenv("FLEXARM_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    return tmp_path / "cache"


def answer(arm: Arm = ARM) -> np.ndarray:
    """Accelerations by code that is loaded or compiled anew, as in a fresh process."""
    for name in [name for name in sys.modules if name.startswith("flexarm_generated_")]:
        del sys.modules[name]
    return compile_arm(arm).accelerations(np.full(3, 0.1), np.full(3, 0.2), np.array([0.3]))


EXPECTED = np.zeros(3)


@pytest.fixture(scope="module", autouse=True)
def expected_answer() -> None:
    """Accelerations by code that no test has damaged."""
    EXPECTED[:] = compile_arm(ARM).accelerations(np.full(3, 0.1), np.full(3, 0.2), np.array([0.3]))


def warned(expected: int = 1) -> np.ndarray:
    """`answer`, with an expected number of cache warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result = answer()
        result = answer()  # the second says nothing new
    found = [str(w.message) for w in caught if w.category is CacheWarning]
    assert len(found) == expected, found
    return result


def generated(folder: Path, suffix: str) -> Path:
    (path,) = folder.glob(f"*{suffix}")
    return path


# ---- what a description may do -------------------------------------------------------------------


@pytest.mark.parametrize("name", HOSTILE.values(), ids=HOSTILE)
def test_a_name_is_text_and_nothing_else(name: str, folder: Path) -> None:
    """The arm compiles, no code of the name runs, and the rest of the source is unchanged."""
    hostile = answer(replace(ARM, name=name, description=name))
    text = generated(folder, ".py").read_text()
    generated(folder, ".py").unlink()
    answer()
    plain = generated(folder, ".py").read_text()

    def rest(source: str) -> str:
        return re.sub(r"^TITLE = .*\n|^# sha256 .*", "", source, flags=re.M)

    np.testing.assert_array_equal(hostile, EXPECTED)
    assert not (folder.parent / "canary").exists()
    assert text.count("TITLE = ") == 1
    assert rest(text) == rest(plain)


# ---- who may write -------------------------------------------------------------------------------


def test_the_folder_is_made_private(folder: Path) -> None:
    answer()
    assert folder.stat().st_mode & 0o777 == 0o700


def planted(folder: Path) -> None:
    """Complete files with valid digests, written by an attacker who knows the format."""
    answer()
    for path in folder.glob("*.py"):
        source = load(path.name)
        assert source is not None
        store(path.name, source + f"\n{CANARY}\n".encode())


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="no owners and modes here")
@pytest.mark.parametrize("mode", [0o777, 0o770, 0o702])
def test_nothing_is_taken_from_a_folder_that_others_may_write(mode: int, folder: Path) -> None:
    planted(folder)
    folder.chmod(mode)
    np.testing.assert_array_equal(warned(), EXPECTED)
    assert not (folder.parent / "canary").exists()


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="no owners and modes here")
def test_nothing_is_taken_from_another_users_folder(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    planted(folder)
    other = os.geteuid() + 1
    monkeypatch.setattr(os, "geteuid", lambda: other)
    np.testing.assert_array_equal(warned(), EXPECTED)
    assert not (folder.parent / "canary").exists()


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="no owners and modes here")
def test_nothing_is_taken_from_where_others_could_have_put_the_folder(folder: Path) -> None:
    """A sticky bit, as on /tmp, keeps others from renaming the folder."""
    planted(folder)
    folder.parent.chmod(0o777)
    np.testing.assert_array_equal(warned(), EXPECTED)
    assert not (folder.parent / "canary").exists()
    folder.parent.chmod(0o1777)
    answer()
    assert (folder.parent / "canary").exists()


# ---- damage --------------------------------------------------------------------------------------

DAMAGE: dict[str, Callable[[bytes], bytes]] = {
    "truncated": lambda data: data[: len(data) // 2],
    "without its end": lambda data: data[:-1],
    "empty": lambda data: b"",
    "random": lambda data: np.random.default_rng(0).bytes(len(data)),
    "another operation": lambda data: data.replace(b" + ", b" * ", 1),
    "one bit": lambda data: data[:999] + bytes([data[999] ^ 1]) + data[1000:],
    "not text": lambda data: b"\xff" + data,
}


@pytest.mark.parametrize("damage", DAMAGE.values(), ids=DAMAGE)
@pytest.mark.parametrize("suffix", [".py", ".nbc"])
def test_a_damaged_file_is_made_anew(
    suffix: str, damage: Callable[[bytes], bytes], folder: Path
) -> None:
    answer()
    path = generated(folder, suffix)
    whole = path.read_bytes()
    path.write_bytes(damage(whole))
    expected = path.read_bytes() != whole
    np.testing.assert_array_equal(warned(expected), EXPECTED)
    assert load(path.name) is not None
    np.testing.assert_array_equal(warned(0), EXPECTED)


def test_compiled_code_that_numba_cannot_load_is_made_anew(folder: Path) -> None:
    """The file has a valid digest but is not machine code."""
    answer()
    for content in (b"", b"not a pickle", b"\x80\x04N."):
        store(generated(folder, ".nbc").name, content)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", CacheWarning)
            np.testing.assert_array_equal(answer(), EXPECTED)
        assert load(generated(folder, ".nbc").name) != content


def test_a_folder_in_the_place_of_a_file_does_no_harm(folder: Path) -> None:
    answer()
    path = generated(folder, ".py")
    path.unlink()
    path.mkdir()
    np.testing.assert_array_equal(warned(), EXPECTED)


# ---- nowhere to write ----------------------------------------------------------------------------


@pytest.mark.parametrize("place", ["a file", "below a file", "nowhere"])
def test_without_a_cache_arms_are_compiled_in_memory(
    place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    paths = {"a file": "file", "below a file": "file/cache", "nowhere": "/proc/flexarm/cache"}
    monkeypatch.setenv("FLEXARM_CACHE", str(tmp_path / paths[place]))
    np.testing.assert_array_equal(warned(), EXPECTED)


SESSION = """
import numpy as np
from dynamics import compile_arm
print(compile_arm("slim").accelerations(np.full(3, 0.1), np.full(3, 0.2), [0.3]).tolist())
"""


def session(folder: Path, before: str = "") -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", before + SESSION], cwd=ROOT, text=True,
        env=os.environ | {"FLEXARM_CACHE": str(folder)},
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="profiles have a home here")
def test_users_without_a_home_have_a_private_folder_among_the_temporary_ones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import pwd

    def unknown(uid: int) -> None:
        raise KeyError(uid)

    for name in ("FLEXARM_CACHE", "HOME", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(pwd, "getpwuid", unknown)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    store("name", b"content")
    (folder,) = tmp_path.iterdir()
    assert folder == cache_folder()
    assert folder.stat().st_mode & 0o777 == 0o700
    assert load("name") == b"content"


def test_a_full_disk_costs_a_warning(tmp_path: Path) -> None:
    """With files limited to 1000 bytes, the results are the same."""
    pytest.importorskip("resource")
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n"
    process = session(tmp_path / "cache", limit)
    out, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    assert out.strip() == str(EXPECTED.tolist())
    assert err.count("CacheWarning") == 1
    assert "File too large" in err
    assert list((tmp_path / "cache").iterdir()) == []


def test_processes_that_start_at_once_on_an_empty_cache_do_not_disturb_each_other(
    tmp_path: Path,
) -> None:
    processes = [session(tmp_path / "cache") for _ in range(4)]
    results = [process.communicate(timeout=300) for process in processes]
    assert results == 4 * [(f"{EXPECTED.tolist()}\n", "")]
    assert all(load_from(tmp_path / "cache", path.name) for path in (tmp_path / "cache").iterdir())


def load_from(folder: Path, name: str) -> bytes | None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FLEXARM_CACHE", str(folder))
        return load(name)


def test_kept_text_is_built_once(folder: Path) -> None:
    texts = iter(["first", "second"])
    assert [kept("x", lambda: next(texts)) for _ in range(3)] == 3 * ["first"]


def test_arms_with_the_same_equations_keep_their_own_compiled_code(folder: Path) -> None:
    """Code refers to its module, which another process may never load."""
    twin = replace(ARM, links=tuple(replace(link, EIy=1.0) for link in ARM.links))
    answer()
    with warnings.catch_warnings():
        warnings.simplefilter("error", CacheWarning)
        np.testing.assert_array_equal(answer(twin), EXPECTED)
    texts = {load(path.name) for path in folder.glob("*.py")}
    assert len(texts) == 1
    assert len(list(folder.glob("*.py"))) == len(list(folder.glob("*.nbc"))) == 2
