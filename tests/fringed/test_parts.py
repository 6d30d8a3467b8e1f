"""Parts of clouds, and the topics that ask for them."""

from __future__ import annotations

from itertools import combinations

import pytest

from fringed.errors import FringedError
from fringed.parts import PARTS, parse_parts, parts_of, topic_of
from fringed.wire import MAX_TOPIC_BYTES

_OTHERS = [name for name in PARTS if name != "xyz"]
EVERY = [("xyz", *chosen) for count in range(len(PARTS)) for chosen in combinations(_OTHERS, count)]


def test_a_topic_names_its_parts_and_is_no_beginning_of_another() -> None:
    topics = [topic_of(parts) for parts in EVERY]
    assert [parts_of(topic) for topic in topics] == EVERY
    assert len(set(topics)) == len(topics) == 32
    for topic in topics:
        assert len(topic) <= MAX_TOPIC_BYTES
        assert not any(other.startswith(topic) for other in (*topics, "cloud/full", "cloud/depth") if other != topic)


def test_the_order_of_the_names_does_not_matter() -> None:
    assert parse_parts("normals, rgb ,xyz") == parse_parts(["rgb", "xyz", "normals"]) == ("xyz", "rgb", "normals")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "--parts names no part; choose from xyz, gray, sigma, rgb, normals, interpolated"),
        (" , ", "--parts names no part; choose from xyz"),
        ("xyz,nonsense", "--parts: there is no part 'nonsense'; choose from xyz"),
        ("xyz,", "--parts: there is no part ''; choose from"),
        ("xyz,rgb,rgb", "--parts names the part 'rgb' 2 times, limit 1; name each once"),
        ("rgb,normals", "--parts is 'rgb,normals' without 'xyz'; every cloud has its points: add xyz"),
    ],
)
def test_a_wrong_list_is_refused_with_name_value_and_limit(text: str, message: str) -> None:
    with pytest.raises(FringedError) as error:
        parse_parts(text, "--parts")
    assert str(error.value).startswith(message)


@pytest.mark.parametrize(
    "topic", ["cloud/full", "cloud/parts/", "cloud/parts/xyz", "cloud/parts/rgb,xyz/", "cloud/parts/xyz,soup/", ""]
)
def test_other_topics_ask_for_no_parts(topic: str) -> None:
    assert parts_of(topic) is None
