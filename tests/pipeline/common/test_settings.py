"""Settings by name: names of the last release, values outside of their limits."""

import dataclasses
import warnings

import pytest

from pipeline.common.errors import PipelineError
from pipeline.common.settings import RENAMED, Settings


@pytest.mark.parametrize(("old", "new"), RENAMED.items())
def test_a_former_name_sets_the_same_with_a_warning(old, new):
    value = getattr(Settings(), new) + 1 if new == "cluster_min_area" else 0.19
    with pytest.warns(FutureWarning, match=f"{old} is called {new}"):
        by_old = Settings().with_overrides({old: value})
    assert by_old == Settings().with_overrides({new: value}) != Settings()


def test_a_setting_by_both_of_its_names_is_refused():
    with (
        warnings.catch_warnings(action="ignore"),
        pytest.raises(PipelineError, match="cluster_min_area is given twice"),
    ):
        Settings().with_overrides({"cluster_min_area": 60, "min_component": 80})


def test_no_former_name_is_a_name_again():
    assert not RENAMED.keys() & {field.name for field in dataclasses.fields(Settings)}
