"""Read untrusted JSON and YAML files as plain data, within size limits."""

import json
import re
import stat
from os import PathLike, fspath
from pathlib import Path
from typing import Any

import yaml

from dynamics.description.validate import shown, unique

MOST_BYTES = {".json": 16_777_216, ".yaml": 1_048_576, ".yml": 1_048_576}
_MERGE = "tag:yaml.org,2002:merge"
_NUMBERS = {f"tag:yaml.org,2002:{kind}" for kind in ("int", "float")}
_ODD = re.compile(r"[-+]?0[0-9_]+$|.*:")  # octal numbers, and sexagesimal ones such as 1:30
MOST_NODES = 50_000  # values of a YAML file with aliases expanded


def user_path(given: str | PathLike[str]) -> Path:
    """Path as a user writes it, where `~` is a home; shells leave it in quotes and behind `=`."""
    path = Path(fspath(given))
    try:
        return path.expanduser()
    except RuntimeError:
        raise ValueError(
            f"{shown(str(path))} begins with the home of a user who has none; write the whole path."
        ) from None


def read_mapping(path: Path) -> dict[str, Any]:
    """Read the mapping in a JSON or YAML file.

    Raises
    ------
    ValueError : if the file cannot be read or repeats a key; one sentence with the reason.
    """
    suffix = path.suffix.lower()
    if suffix not in MOST_BYTES:
        raise ValueError(f"must end in .json, .yaml or .yml, got {shown(path.suffix)}.")
    content = read_text(path, MOST_BYTES[suffix])
    try:
        if suffix == ".json":
            data = json.loads(content, object_pairs_hook=unique, parse_int=_integer)
        else:
            data = yaml.load(content, _Loader)  # a SafeLoader
    except json.JSONDecodeError as error:
        raise ValueError(
            f"is not valid JSON: {error.msg} at line {error.lineno}, column {error.colno}."
        ) from None
    except yaml.YAMLError as error:
        raise ValueError(f"is not valid YAML: {' '.join(str(error).split())}.") from None
    except RecursionError:
        raise ValueError("is nested too deeply.") from None
    except TypeError as error:  # from PyYAML: odd keys
        raise ValueError(f"holds a value that cannot be read: {error}.") from None
    if not isinstance(data, dict):
        raise ValueError(f"must hold a mapping at the top, got a {type(data).__name__}.")
    return data


def read_text(path: Path, most: int) -> str:
    """Read a regular file of UTF-8 text of at most `most` bytes; raises ValueError as above."""
    try:
        return read_bytes(path, most).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(
            f"must be UTF-8 text ({error.reason} at byte {error.start}); save it as UTF-8."
        ) from None


def read_bytes(path: Path, most: int) -> bytes:
    """Read a regular file of at most `most` bytes; raises ValueError as above."""
    try:
        if not stat.S_ISREG(path.stat().st_mode):  # reading a pipe would block
            raise OSError("not a regular file")
        with open(path, "rb") as file:
            content = file.read(most + 1)
    except FileNotFoundError:
        raise ValueError(f"no such file in {path.absolute().parent}.") from None
    except (OSError, ValueError) as error:  # ValueError: a path with a zero byte
        raise ValueError(f"cannot read {shown(str(path))}: {error}.") from None
    if len(content) > most:
        raise ValueError(f"must have at most {most} bytes, got more.")
    return content


def _integer(digits: str) -> float:
    """Return an int, or infinity for more digits than Python reads."""
    try:
        return int(digits)
    except ValueError:
        return float(digits)


class _Loader(yaml.SafeLoader):
    """YAML's safe loader with a limit on values; raises ValueError for a repeated key."""

    def __init__(self, stream: str) -> None:
        super().__init__(stream)
        self._sizes: dict[int, int] = {}  # node id -> number of values in the node, itself included
        self._count = 0
        self._flat: set[int] = set()  # ids of the mappings whose keys were compared

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Count values; an alias adds the size of its node."""
        alias = self.check_event(yaml.AliasEvent)
        node: Any = super().compose_node(parent, index)
        if alias and id(node) not in self._sizes:
            raise ValueError("must not contain an alias inside the node it refers to.")
        if not alias:
            within = (self._sizes[id(child)] for child in _children(node))
            self._sizes[id(node)] = 1 + sum(within)
        self._count += self._sizes[id(node)] if alias else 1
        if self._count > MOST_NODES:
            raise ValueError(f"must hold at most {MOST_NODES} values with aliases expanded.")
        return node

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        """Build a value; raise ValueError with its place for one that its tag cannot read."""
        try:
            value = super().construct_object(node, deep)
        except (ArithmeticError, AttributeError, LookupError, ValueError):  # from PyYAML
            if not isinstance(node, yaml.ScalarNode):
                raise
            mark = node.start_mark
            raise ValueError(
                f"holds a value that cannot be read: {shown(node.value)} at line {mark.line + 1}, "
                f"column {mark.column + 1}."
            ) from None
        if isinstance(node, yaml.ScalarNode) and node.tag in _NUMBERS and _ODD.match(node.value):
            mark = node.start_mark
            raise ValueError(
                f"holds {node.value} at line {mark.line + 1}, column {mark.column + 1}, which YAML "
                f"reads as {value!r}; write {value!r}, or the decimal number that you mean."
            )
        return value

    def flatten_mapping(self, node: yaml.MappingNode) -> None:
        """Merge the mappings of "<<" into the node, whose own keys must differ."""
        if id(node) not in self._flat:
            self._flat.add(id(node))
            own = [key for key, _ in node.value if key.tag != _MERGE]
            unique([(str(self.construct_object(key, deep=True)), None) for key in own])
        super().flatten_mapping(node)


def _children(node: yaml.Node) -> list[Any]:
    if isinstance(node, yaml.MappingNode):
        return [part for pair in node.value for part in pair]
    return node.value if isinstance(node, yaml.SequenceNode) else []
