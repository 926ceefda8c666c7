"""Where MuJoCo keeps its arrays: as declared, or refused."""

import ctypes

import mujoco
import pytest
from scenes import WAVES, model

from sim import Buoyancy
from sim.coupling import layout


def test_offsets_lead_to_the_arrays_of_another_model():
    """Not only of the one that they were held against."""
    compiled, places = model(custom=WAVES), layout.offsets()
    data = mujoco.MjData(compiled)
    for owner, names in ((compiled, ("body_inertia", "numeric_data")), (data, ("cvel", "M"))):
        for name in names:
            found = ctypes.c_int64.from_address(owner._address + places[name]).value
            assert found == getattr(owner, name).ctypes.data
    assert ctypes.c_double.from_address(compiled._address + places["timestep"]).value == 0.005


@pytest.mark.parametrize("field", layout.OPTIONS + layout.MODEL + layout.DATA)
def test_a_field_that_is_elsewhere_is_noticed(field, monkeypatch):
    shifted = layout._declared() | {field: layout._declared()[field] + 8}
    monkeypatch.setattr(layout, "_declared", lambda: shifted)
    with pytest.raises(RuntimeError, match=f"keeps {field} elsewhere than it declares"):
        Buoyancy.from_model(model())
