"""Damage to OpenDRIVE text, the same for the same seed."""

from __future__ import annotations

import random
import re
from collections.abc import Callable
from xml.etree import ElementTree as ET

ATTRIBUTE = re.compile(rb' ([A-Za-z]+)="([^"]*)"')
NUMBER = re.compile(rb' ([A-Za-z]+)="(-?[0-9][0-9.eE+-]*)"')
WRONG_NUMBERS = (b"0", b"-1", b"1e9", b"-1e9", b"nan", b"inf", b"abc", b"", b"1e-9", b"7", b"1e400", b"250")
IDS = ("id", "elementId", "connectingRoad", "incomingRoad", "from", "to", "junction")


def truncate(text: bytes, rng: random.Random) -> bytes:
    """The beginning of the file."""
    return text[: rng.randrange(len(text))]


def drop_bytes(text: bytes, rng: random.Random) -> bytes:
    """A few bytes missing in a few places."""
    for _ in range(rng.choice([1, 1, 3])):
        at = rng.randrange(len(text))
        text = text[:at] + text[at + rng.choice([1, 2, 10, 2000]) :]
    return text


def change_bytes(text: bytes, rng: random.Random) -> bytes:
    """A byte that is another."""
    at = rng.randrange(len(text))
    return text[:at] + bytes([rng.randrange(256)]) + text[at + 1 :]


def change_digit(text: bytes, rng: random.Random) -> bytes:
    """A digit of a number that is another: the file stays well-formed."""
    at = rng.choice([found.start() for found in re.finditer(rb"[0-9]", text)])
    return text[:at] + str(rng.randrange(10)).encode() + text[at + 1 :]


def delete_attribute(text: bytes, rng: random.Random) -> bytes:
    """An attribute that is gone."""
    found = rng.choice(list(ATTRIBUTE.finditer(text)))
    return text[: found.start()] + text[found.end() :]


def wrong_number(text: bytes, rng: random.Random) -> bytes:
    """A number that is another, or none."""
    found = rng.choice(list(NUMBER.finditer(text)))
    return text[: found.start(2)] + rng.choice(WRONG_NUMBERS) + text[found.end(2) :]


def wrong_numbers(text: bytes, rng: random.Random) -> bytes:
    """All numbers of one attribute's name replaced: every width, every length."""
    name = rng.choice([found[1] for found in NUMBER.finditer(text)])
    value = rng.choice(WRONG_NUMBERS)
    return re.sub(rb' %s="[^"]*"' % name, rb' %s="%s"' % (name, value), text)


def delete_element(text: bytes, rng: random.Random) -> bytes:
    """An element that is gone, with what it holds."""
    root = ET.fromstring(text)
    parent, child = rng.choice([(parent, child) for parent in root.iter() for child in parent])
    parent.remove(child)
    return ET.tostring(root)


def repeat_element(text: bytes, rng: random.Random) -> bytes:
    """An element that is there twice."""
    root = ET.fromstring(text)
    parent, child = rng.choice([(parent, child) for parent in root.iter() for child in parent])
    parent.append(child)
    return ET.tostring(root)


def swap_ids(text: bytes, rng: random.Random) -> bytes:
    """Two references or ids of one kind that have changed places."""
    root = ET.fromstring(text)
    key = rng.choice(IDS)
    owners = [element for element in root.iter() if key in element.attrib]
    if len(owners) > 1:
        first, second = rng.sample(owners, 2)
        first.attrib[key], second.attrib[key] = second.attrib[key], first.attrib[key]
    return ET.tostring(root)


def link_to_itself(text: bytes, rng: random.Random) -> bytes:
    """A road that follows itself."""
    root = ET.fromstring(text)
    roads = [road for road in root.findall("road") if road.find("link/*") is not None]
    road = rng.choice(roads)
    for end in road.findall("link/*"):
        end.attrib.update(elementType="road", elementId=road.attrib["id"], contactPoint=rng.choice(["start", "end"]))
    return ET.tostring(root)


KINDS: tuple[Callable[[bytes, random.Random], bytes], ...] = (
    truncate,
    drop_bytes,
    change_bytes,
    change_digit,
    delete_attribute,
    wrong_number,
    wrong_numbers,
    delete_element,
    repeat_element,
    swap_ids,
    link_to_itself,
)


def mutated(text: bytes, seed: int) -> tuple[str, bytes]:
    """What was done, and the damaged text; seeds go through the kinds in turn."""
    kind = KINDS[seed % len(KINDS)]
    return kind.__name__, kind(text, random.Random(seed))
