from pathlib import Path

import pytest

from dynamics import load_arm
from dynamics.description import data_file


def test_a_yaml_file_holds_as_many_values_as_it_may_with_aliases_expanded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A mapping with two keys, and two lists of six numbers, the second by an alias."""
    path, data = tmp_path / "arm.yaml", {"a": 6 * [1], "b": 6 * [1]}
    path.write_text("a: &list [1, 1, 1, 1, 1, 1]\nb: *list\n")
    monkeypatch.setattr(data_file, "MOST_NODES", 1 + len(data) + 2 * (1 + 6))
    assert data_file.read_mapping(path) == data
    monkeypatch.setattr(data_file, "MOST_NODES", len(data) + 2 * (1 + 6))
    with pytest.raises(ValueError, match="at most 16 values with aliases"):
        data_file.read_mapping(path)


BAD_FILES = {
    "arm.json: is not valid JSON: .* line 1": ("arm.json", b"{"),
    "arm.yaml: is not valid YAML": ("arm.yaml", b"links: ["),
    "'links'. stand twice": ("arm.json", b'{"links": [], "links": []}'),
    "'length'. stand twice": ("arm.yaml", b"links: [{length: 1.0, length: 2.0}]"),
    "must be UTF-8 text .*; save it as UTF-8": ("arm.json", b"\xff\xfe"),
    "must hold a mapping": ("arm.json", b"[]"),
    "must end in .json": ("arm.toml", b""),
    "nested too deeply": ("arm.json", b"[" * 100_000),
    "Link.length .m. must be a finite number, got inf": (
        "arm.json",
        b'{"links": [{"length": ' + 5000 * b"9" + b', "rho_A": 1.0}]}',
    ),
    "cannot be read: '2026-13-01' at line 1, column 18": (
        "arm.yaml",
        b"links: [{length: 2026-13-01, rho_A: 1.0}]",
    ),
    "cannot be read: 'maybe' at line 1, column 18": (
        "arm.yaml",
        b"links: [{length: !!bool maybe, rho_A: 1.0}]",
    ),
    "cannot be read: 'today' at line 1, column 9": ("arm.yaml", b"links: [!!timestamp today]"),
    "cannot be read: '' at line 1, column 9": ("arm.yaml", b"links: [!!int '']"),
    "cannot be read: '999.*999' at line 1, column 18": (
        "arm.yaml",
        b"links: [{length: " + 5000 * b"9" + b", rho_A: 1.0}]",
    ),
    "holds 010 at line 1, column 18, which YAML reads as 8; write 8, or the decimal": (
        "arm.yaml",
        b"links: [{length: 010, rho_A: 1.0}]",
    ),
    "holds 1:30 at line 1, column 18, which YAML reads as 90; write 90": (
        "arm.yaml",
        b"links: [{length: 1:30, rho_A: 1.0}]",
    ),
    "holds 0:01.5 at line 2, column 8, which YAML reads as 1.5": (
        "arm.yaml",
        b"links: [{length: 1.0,\nrho_A: 0:01.5}]",
    ),
    "got the text '5e-1' .*3.0e-4": ("arm.yaml", b"links: [{length: 5e-1, rho_A: 1.0}]"),
}


@pytest.mark.parametrize("sentence", BAD_FILES)
def test_a_bad_file_is_refused_by_name(sentence: str, tmp_path: Path) -> None:
    name, content = BAD_FILES[sentence]
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ValueError, match=sentence) as caught:
        load_arm(tmp_path / name)
    assert str(caught.value).startswith(f"{name}: ")


@pytest.mark.parametrize("name", ["arm.json", "arm.yaml"])
def test_a_byte_order_mark_changes_nothing(name: str, tmp_path: Path) -> None:
    """As Windows writes it in front of a file."""
    content = b'{"links": [{"length": 1.0, "rho_A": 2.0}]}'
    arms = []
    for mark in (b"", b"\xef\xbb\xbf"):
        (tmp_path / name).write_bytes(mark + content)
        arms.append(load_arm(tmp_path / name))
    assert arms[0] == arms[1]


def test_a_home_that_no_shell_has_replaced_is_the_users(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    assert data_file.user_path("~/arm.yaml") == tmp_path / "arm.yaml"
    assert data_file.user_path("arms/~arm.yaml") == Path("arms/~arm.yaml")
    with pytest.raises(ValueError, match="home of a user who has none; write the whole path"):
        data_file.user_path("~nobody-here/arm.yaml")
