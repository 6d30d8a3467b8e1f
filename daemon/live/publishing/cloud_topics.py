"""The messages of a cloud for the topics that have subscribers: as they are, with chosen parts, in shared memory."""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Iterable, Sequence
from functools import cache, partial

from daemon.live.items import CloudItem
from daemon.live.publishing import messages
from daemon.live.publishing.messages import Frames, Origin
from daemon.live.publishing.shared_clouds import SharedClouds
from fringed.parts import copied_topic, parts_of

log = logging.getLogger("fringed.stream")

_CLOUDS_UNTIL_NEXT_TRIAL = 100  # where memory could not be had

Makers = dict[str, Callable[[], Frames | None]]


class CloudTopics:
    """Topics of clouds that have subscribers; a message is made when its maker is called.

    Args:
        shared: memory for subscribers on this machine.
    """

    def __init__(self, shared: SharedClouds) -> None:
        self._shared, self._shared_topics = shared, dict[str, str]()
        self._parts_topics = dict[str, tuple[str, ...]]()
        self.problem, self._wait = "", 0

    def note(self, prefixes: Iterable[bytes]) -> None:
        """Take the subscriptions; in new mappings, because the pipeline's thread reads them."""
        topics = [prefix.decode("ascii", "replace") for prefix in sorted(prefixes)]
        self._shared_topics = {topic: copied for topic in topics if (copied := copied_topic(topic)) is not None}
        named = {topic: parts_of(self._shared_topics.get(topic, topic)) for topic in topics}
        self._parts_topics = {topic: parts for topic, parts in named.items() if parts is not None}

    def wanted_parts(self) -> frozenset[str]:
        """Parts that subscribers ask for."""
        return frozenset(name for parts in self._parts_topics.values() for name in parts)

    def makers(self, origin: Origin, item: CloudItem, full_parts: Sequence[str]) -> Makers:
        """What makes the message of each topic.

        Those in shared memory are first: they are short, and long ones before them would delay them.
        """
        of_full = messages.full_parts(item, full_parts)
        shared = {topic: self._parts_topics.get(topic, of_full) for topic in self._shared_topics}
        references = cache(lambda: self._stored(item, {name for parts in shared.values() for name in parts}))

        def referring(topic: str, parts: Sequence[str]) -> Frames | None:
            return messages.parts(origin, item, topic, parts, references=references())

        makers: Makers = {topic: partial(referring, topic, parts) for topic, parts in shared.items()}
        makers["cloud/full"] = lambda: messages.full(origin, item, full_parts)
        makers["cloud/depth"] = lambda: messages.depth(origin, item)
        for topic, parts in self._parts_topics.items():
            if topic not in shared:
                makers[topic] = partial(messages.parts, origin, item, topic, parts)
        return makers

    def close(self) -> None:
        """Remove the shared memory."""
        self._shared.close()

    def _stored(self, item: CloudItem, names: Collection[str]) -> dict[str, bytes] | None:
        """References to the parts; None, and a warning, where there is no memory: the message then has them itself."""
        if not self._shared.available:
            return None
        if self._wait > 0:
            self._wait -= 1
            return None
        arrays = messages.parts_of_cloud(item.cloud)
        try:
            references = self._shared.store({name: arrays[name] for name in arrays if name in names})
        except OSError as error:
            text = error.strerror or str(error)
            if not self.problem:
                log.warning("clouds are sent instead of shared: %s", text)
            self.problem, self._wait = text, _CLOUDS_UNTIL_NEXT_TRIAL
            return None
        self.problem = ""
        return references


def load_codecs() -> None:
    """Import what depth and preview need before the first of them is made: it takes half a second."""
    import blosc2

    import daemon.live.publishing.preview  # noqa: F401

    # One chunk is compressed in a millisecond; more threads would only slow down the pipeline.
    blosc2.set_nthreads(1)
