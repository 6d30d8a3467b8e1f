"""Read the stream with pyzmq, json and numpy alone: `python 02_plain_reader.py ENDPOINT|FILE [CLOUDS]`.

FILE holds one message: of each frame its length (4 bytes, little-endian), then its bytes.
"""

import json
import sys
from pathlib import Path

import numpy as np
import zmq


def _live(endpoint):
    with zmq.Context() as context, context.socket(zmq.SUB) as socket:
        socket.connect(endpoint)
        socket.subscribe(b"cloud/full")
        while True:
            yield socket.recv_multipart()


def _stored(path):
    data, frames = path.read_bytes(), []
    while data:
        size = int.from_bytes(data[:4], "little")
        frames, data = [*frames, data[4 : 4 + size]], data[4 + size :]
    yield frames


source = sys.argv[1] if len(sys.argv) > 1 else "tcp://127.0.0.1:5555"
for count, (topic, head, *parts) in enumerate(_live(source) if "://" in source else _stored(Path(source)), 1):
    header = json.loads(head)
    assert header["v"] == 1 and len(header["parts"]) == len(parts)
    rows = zip(header["parts"], parts, strict=True)
    arrays = {row["name"]: np.frombuffer(raw, row["dtype"]).reshape(row["shape"]) for row, raw in rows}
    z = arrays["xyz"][..., 2]
    text = f"{np.isfinite(z).sum()} points, mean z {np.nanmean(z):.3f} mm"
    print(topic.decode(), header["seq"], text, *arrays, flush=True)
    if len(sys.argv) > 2 and count == int(sys.argv[2]):
        break
