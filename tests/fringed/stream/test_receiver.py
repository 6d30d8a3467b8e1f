"""A reader that falls behind is only late; it is not ended by its own library."""

import zmq

from fringed.stream.receiver import Receiver


def test_a_short_queue_goes_without_heartbeats():
    """Heartbeats on a connection whose short queue is full abort the process (libzmq #3937)."""
    with Receiver("tcp://127.0.0.1:9", ("cloud/full",)) as receiver:
        assert receiver.socket.getsockopt(zmq.RCVHWM) == 2
        assert receiver.socket.getsockopt(zmq.HEARTBEAT_IVL) == 0
        assert receiver.socket.getsockopt(zmq.TCP_KEEPALIVE) == 1
