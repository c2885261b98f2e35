"""Mutations of files: damage to bytes, hostile texts, numbers and values of another type."""

import json
import random
import re
from collections.abc import Callable, Iterator, Sequence
from functools import partial, reduce
from typing import Any

import yaml

from marl_clean.storage.safe_yaml import Plain
from tests.reliability.formats import Format

Mutation = Callable[[bytes, random.Random], bytes]
NUMBERS = ("NaN", ".nan", "Infinity", "-.inf", "1e308", "1e999", "-1e308", "-1", "0", "1e-320")
NUMBERS += ("2000000000", "9" * 30, "9" * 5000, "0x" + "f" * 5000, str(2**64), "2020-01-01")
TOKENS: tuple[str, ...] = tuple("\0\n\r\t\ufeff\ud800\u202e\x85\u2028[]{}\"',:%|>!~")
TOKENS += (": ", "- ", "? ", "# ", "&a ", "*a", "<<: ", "!!set ", "!!timestamp ", "2020-01-01")
TOKENS += ("!!python/object/apply:os.system ", "???", "${oc.env:HOME}", "${", "null", "[/red]")
TOKENS += ("\\ud800", "\\u0000", "../", "/etc/passwd", "\x1b[31m", '"' + "x" * 100_000 + '"')
TOKENS += ("\n" * 10_000, "," * 10_000, "[]," * 10_000, "a: " * 2_000)
SWAPPED: tuple[Any, ...] = (None, True, -1, 0, 10**30, 1e308, "", "a", "\x1b", [], {}, [[]], [None])
SWAPPED += ({"a": {"b": []}}, [[1, 2]], "x" * 10_000, -(2**63), 2**31, [0.5] * 1000)
SWAPPED += tuple(reduce(lambda inner, _: [inner], range(depth), "a") for depth in (30, 150, 900))
NUMBER = re.compile(rb"-?[0-9]+(\.[0-9]+)?([eE][-+]?[0-9]+)?")


def mutated(content: bytes, draw: random.Random, format: Format) -> bytes:
    """The content after one to three mutations, one in half of all cases."""
    if format.headed and draw.random() < 0.7:
        length = 8 + int.from_bytes(content[:8], "little")
        header = changed(content[8:length], draw, (*OF_BYTES, *OF_TEXT))
        return len(header).to_bytes(8, "little") + header + content[length:]
    return changed(content, draw, OF_BYTES if format.binary else (*OF_BYTES, *OF_TEXT))


def changed(content: bytes, draw: random.Random, kinds: Sequence[Mutation]) -> bytes:
    for _ in range(draw.choice((1, 1, 2, 3))):
        content = draw.choice(kinds)(content, draw) or b"#"
    return content


def _place(content: bytes, draw: random.Random) -> int:
    """Anywhere; half of the places are in the first bytes, where headers are."""
    return draw.randrange(min(len(content), draw.choice((80, len(content)))) + 1)


def flip(content: bytes, draw: random.Random) -> bytes:
    changed = bytearray(content)
    for _ in range(draw.randint(1, 8)):
        changed[draw.randrange(len(changed))] ^= 1 << draw.randrange(8)
    return bytes(changed)


def truncate(content: bytes, draw: random.Random) -> bytes:
    return content[: draw.randrange(len(content))]


def delete(content: bytes, draw: random.Random) -> bytes:
    at = _place(content, draw)
    return content[:at] + content[at + draw.randint(1, 40) :]


def duplicate(content: bytes, draw: random.Random) -> bytes:
    at = _place(content, draw)
    return (
        content[:at] + content[at : at + draw.randint(1, 60)] * draw.randint(2, 20) + content[at:]
    )


def insert(content: bytes, draw: random.Random) -> bytes:
    at = _place(content, draw)
    token = draw.choice((*TOKENS, *NUMBERS)).encode("utf-8", "surrogatepass")
    return content[:at] + token + content[at:]


def nest(content: bytes, draw: random.Random) -> bytes:
    at, opening = _place(content, draw), draw.choice((b"[", b'{"a":', b"{", b"- ", b"["))
    return content[:at] + opening * draw.choice((5, 30, 150, 950, 5_000, 50_000)) + content[at:]


def renumber(content: bytes, draw: random.Random) -> bytes:
    """Replace a number by another, or by what may be taken for one."""
    if not (numbers := list(NUMBER.finditer(content))):
        return insert(content, draw)
    number = draw.choice(numbers)
    return content[: number.start()] + draw.choice(NUMBERS).encode() + content[number.end() :]


def swap(content: bytes, draw: random.Random) -> bytes:
    """Replace a value in JSON or yaml by one of another type; elsewhere the rest of a line."""
    tree, dumped = _parsed(content)
    if not isinstance(tree, dict | list):
        lines = content.split(b"\n")
        at = draw.randrange(len(lines))
        head, mark, _ = lines[at].partition(draw.choice((b":", b",", b"=", b" ")))
        value = json.dumps(draw.choice(SWAPPED)).encode()
        lines[at] = head + mark + b" " + value
        return b"\n".join(lines)
    places = list(_places(tree))
    if not places or draw.random() < 0.02:
        return dumped(draw.choice(SWAPPED)).encode("utf-8", "surrogatepass")
    outer, key = draw.choice(places)
    if draw.random() < 0.2:
        del outer[key]
    else:
        outer[key] = draw.choice(SWAPPED)
    try:
        return dumped(tree).encode("utf-8", "surrogatepass")
    except (ValueError, RecursionError):  # of what an earlier mutation brought in
        return content


def _parsed(content: bytes) -> tuple[Any, Callable[[Any], str]]:
    """The tree in a text of JSON or yaml, None without one, and what writes such a text."""
    try:
        return json.loads(content), json.dumps
    except (ValueError, RecursionError):
        pass
    if b"[" * 100 in content:  # which takes yaml seconds
        return None, json.dumps
    try:
        return yaml.load(content, Plain), partial(yaml.dump, Dumper=yaml.CSafeDumper)
    except (yaml.YAMLError, ValueError, LookupError, AttributeError, TypeError, RecursionError):
        return None, json.dumps


def _places(tree: Any) -> Iterator[tuple[Any, Any]]:
    """Every list or dict in a tree of JSON, with each of its indices or keys."""
    left = [tree]
    while left:
        outer = left.pop()
        keys = list(outer) if isinstance(outer, dict) else range(len(outer))
        for key in keys if isinstance(outer, dict | list) else ():
            yield outer, key
            if isinstance(outer[key], dict | list):
                left.append(outer[key])


OF_BYTES = (flip, truncate, delete, duplicate, insert, nest)
OF_TEXT = (insert, nest, renumber, renumber, renumber, swap, swap, swap, swap)
