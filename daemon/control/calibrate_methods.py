"""The methods ``calibrate.*``: project a sequence and capture it with the cameras while the daemon runs.

``calibrate.capture`` starts a job and returns at once; ``calibrate.status`` reports its progress and, at the end, its
file: a take whose ``pattern.json`` is the sequence. The calibration is solved outside the daemon.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from daemon.control.rpc.params import number
from daemon.control.rpc.protocol import FAILED, INVALID_PARAMS, Method, RpcError
from daemon.control.sequence_capture import LONGEST_HOLD_S, MOST_PAIRS, Capture, CaptureRequest
from daemon.live.service import Service
from pipeline.common.errors import CalibrationError, PatternError
from pipeline.pattern.sequence import FrameSequence
from pipeline.pattern.sequence import from_mapping as sequence_from_mapping
from pipeline.rig.calibration import Response

_MOST_LEVELS = 256
_CURVES = ("red", "green", "blue")


class CalibrateMethods:
    """RPC methods of one capture; their errors name the parameter."""

    def __init__(self, service: Service, capture: Capture) -> None:
        self._service, self._capture = service, capture

    def table(self) -> dict[str, Method]:
        """Return every method by its name."""
        return {
            "calibrate.capture": Method(self.capture, ("frames", "pairs", "hold_s", "name", "response")),
            "calibrate.status": Method(self.status),
            "calibrate.cancel": Method(lambda _: self._capture.cancel()),
            "calibrate.next_pose": Method(self.next_pose, slow=True),
        }

    def capture(self, params: dict[str, Any]) -> dict[str, Any]:
        """Start a capture.

        Params: ``frames``, 1 to 512 pattern descriptions of the projector's size; ``pairs``, passes through them (1);
        ``hold_s``, how long the last image stays for the next capture (0); ``name`` of the sequence; ``response`` of
        the projector, levels and red, green, blue as in a calibration file, for fringes (none: not corrected).
        """
        request = CaptureRequest(
            sequence=self._sequence(params),
            pairs=int(number(params, "pairs", 1, 1, MOST_PAIRS, whole=True)),
            hold_s=number(params, "hold_s", 0, 0, LONGEST_HOLD_S),
            response=_response(params),
        )
        return self._capture.start(request)

    def status(self, _: dict[str, Any]) -> dict[str, Any]:
        """Return the newest capture's progress, the projector's size, and whether a hand is simulated."""
        projector, hand = self._service.projector, self._service.rig.board is not None
        size = None if projector is None else list(projector.size)
        return self._capture.status() | {"projector": size, "hand": hand}

    def next_pose(self, _: dict[str, Any]) -> dict[str, Any]:
        """Move the board of a simulated rig to its next pose."""
        board = self._service.rig.board
        if board is None:
            raise RpcError(FAILED, "this rig has no simulated hand: move the board yourself")
        return {"pose": board.next_pose()}

    @property
    def capturing(self) -> bool:
        """Whether a capture uses the projector."""
        return self._capture.active

    def refuse_while_capturing(self) -> None:
        """Raise RpcError while a capture uses the projector."""
        if self._capture.active:
            raise RpcError(FAILED, "the projector is showing images for a capture; end it with calibrate.cancel")

    def _sequence(self, params: dict[str, Any]) -> FrameSequence:
        data = {"kind": "sequence", "name": params.get("name", "capture"), "frames": params.get("frames")}
        try:
            sequence = sequence_from_mapping(data)
        except PatternError as error:
            named = re.match(r"pattern\.([\w.\[\]]+)", str(error))
            raise RpcError(
                INVALID_PARAMS, str(error).replace("pattern.", "", 1), named[1] if named else None
            ) from error
        projector = self._service.projector
        if projector is not None and sequence.size != projector.size:
            raise RpcError(
                INVALID_PARAMS,
                f"frames[0].size is {list(sequence.size)}, the projector shows {list(projector.size)} pixels",
                "frames[0].size",
            )
        return sequence


def _response(params: Mapping[str, Any]) -> Response | None:
    data = params.get("response")
    if data is None:
        return None
    if not isinstance(data, dict) or not {"levels", *_CURVES} <= set(data):
        raise RpcError(INVALID_PARAMS, "response needs levels, red, green and blue", "response")
    rows = [data[key] for key in ("levels", *_CURVES)]
    if not all(isinstance(row, list) and 2 <= len(row) <= _MOST_LEVELS for row in rows):
        raise RpcError(INVALID_PARAMS, f"response: expected lists of 2 to {_MOST_LEVELS} numbers", "response")
    try:
        levels, *curves = (np.array(row, np.float64) for row in rows)
        return Response(levels, np.stack(curves))
    except (CalibrationError, ValueError, TypeError) as error:
        raise RpcError(INVALID_PARAMS, f"response: {error}", "response") from error
