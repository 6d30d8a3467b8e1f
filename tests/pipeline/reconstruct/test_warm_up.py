"""What warming up promises: after it nothing is compiled while pairs come in."""

import subprocess
import sys

import numpy as np
import pytest

from tests.pipeline.small import images, pair

_PROGRAM = """
import sys
from dataclasses import replace
from numba.core.registry import CPUDispatcher
import numpy as np
from pipeline.common.parallel_for import ParallelFor
from tests.pipeline import small

def compiled():
    ours = [module for name, module in list(sys.modules.items()) if name.partition(".")[0] == "pipeline"]
    names = [v for module in ours for v in vars(module).values()]
    kernels = {id(v): v for v in names if isinstance(v, CPUDispatcher)}
    kernels |= {id(v): v.dispatcher for v in names if isinstance(v, ParallelFor)}
    return sum(len(kernel.signatures) for kernel in kernels.values())

encoding, folder = sys.argv[1:]
for fraction in (0.382, 0.5):  # with the projector in the middle fringes repeat, which other kernels judge
    small.LAYOUT = replace(small.LAYOUT, projector_fraction=fraction)
    made = small.reconstructor(encoding=encoding)
    made.warm_up(strides=(1, 2), use_prior=True)
    before = compiled()
    for number, stride, use_prior in ((0, 1, False), (1, 1, True), (2, 2, True), (3, 1, True)):
        left, right = (np.load(f"{folder}/{side}{number}.npy") for side in ("left", "right"))
        for image in (left, right):
            image.setflags(write=False)
        made.reconstruct(left, right, stride=stride, use_prior=use_prior)
    print(before > 20, compiled() - before)
"""


@pytest.mark.parametrize("encoding", ["rgb8", pytest.param("bayer_grbg8", marks=pytest.mark.long)])
def test_nothing_is_compiled_after_warming_up(encoding, tmp_path):
    for number in range(4):
        for side, image in zip(("left", "right"), images(pair("moving", number, encoding)), strict=True):
            np.save(tmp_path / f"{side}{number}.npy", image)
    # In a process of its own: in this one other tests have compiled everything.
    done = subprocess.run(
        [sys.executable, "-c", _PROGRAM, encoding, str(tmp_path)],
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == "True 0\nTrue 0\n"
