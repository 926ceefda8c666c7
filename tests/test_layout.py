"""Where MuJoCo keeps its arrays: as declared, or refused."""

import ctypes

import mujoco
import pytest
from scenes import WAVES, model

from independent import MODELS
from sim.plugin import layout


def test_offsets_lead_to_the_arrays_of_another_model():
    """Not only of the one that they were held against."""
    compiled, places = model(custom=WAVES), layout.offsets()
    data = mujoco.MjData(compiled)
    for owner, names in ((compiled, ("body_inertia", "numeric_size")), (data, ("cvel", "M"))):
        for name in names:
            found = ctypes.c_int64.from_address(owner._address + places[name]).value
            assert found == getattr(owner, name).ctypes.data
    assert ctypes.c_double.from_address(compiled._address + places["timestep"]).value == 0.005


@pytest.fixture
def shift(monkeypatch):
    """Make a field be declared 8 bytes from where it is, for models yet to come."""

    def shifted(field: str) -> None:
        layout._example()
        places = layout._declared() | {field: layout._declared()[field] + 8}
        monkeypatch.setattr(layout, "_declared", lambda: places)
        layout.offsets.cache_clear()

    yield shifted
    layout.offsets.cache_clear()


FIELDS = {*layout.OPTION_FIELDS, *layout.MODEL_FIELDS, *layout.DATA_FIELDS} - {"nplugin"}
"""Behind nplugin stands npluginattr, which is the same number where no plugin has attributes."""


@pytest.mark.parametrize("field", sorted(FIELDS))
def test_a_field_that_is_elsewhere_is_noticed(field, shift):
    shift(field)
    with pytest.raises(RuntimeError, match=f"keeps {field} elsewhere than it declares"):
        layout.offsets()


@pytest.mark.parametrize("name", layout.CONTENT_FIELDS + layout.MATRIX_FIELDS)
def test_what_hulls_are_made_from_is_looked_for_where_it_is(name):
    """Its place, the number of its rows and their size, in a model of several of each."""
    robot = MODELS / "articulated.xml"
    for compiled in (mujoco.MjModel.from_xml_path(str(robot)), model(custom=WAVES)):
        span, found = layout.content_spans()[name], getattr(compiled, name)
        rows = ctypes.c_int32.from_address(compiled._address + span.counter).value
        place = ctypes.c_int64.from_address(compiled._address + span.pointer).value
        if isinstance(found, bytes):
            assert ctypes.string_at(place, rows * span.row_size) == found
        else:
            assert place == found.ctypes.data or found.size == 0
            assert rows * span.row_size == found.nbytes


def test_no_model_floats_whose_fields_are_elsewhere(shift, capfd):
    shift("cvel")
    with pytest.raises(ValueError, match="keeps cvel elsewhere than it declares"):
        model(custom='<numeric name="water_level" data="-0.125"/>')
    assert "RuntimeError" in capfd.readouterr().err
