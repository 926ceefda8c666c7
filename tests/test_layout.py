"""The declared layout of MuJoCo's structures: checked, and refused if it differs."""

import ctypes

import mujoco
import pytest
from scenes import WAVES, model

from independent import MODELS
from sim.plugin import layout


def test_offsets_hold_for_other_models():
    """They are checked on an example model, and hold for others too."""
    compiled, offsets = model(custom=WAVES), layout.offsets()
    data = mujoco.MjData(compiled)
    for owner, names in ((compiled, ("body_inertia", "numeric_size")), (data, ("cvel", "M"))):
        for name in names:
            found = ctypes.c_int64.from_address(owner._address + offsets[name]).value
            assert found == getattr(owner, name).ctypes.data
    assert ctypes.c_double.from_address(compiled._address + offsets["timestep"]).value == 0.005


@pytest.fixture
def shift(monkeypatch):
    """A function that declares a field 8 bytes after its true offset, for later models."""

    def shifted(field: str) -> None:
        layout._example()
        offsets = layout._declared() | {field: layout._declared()[field] + 8}
        monkeypatch.setattr(layout, "_declared", lambda: offsets)
        layout.offsets.cache_clear()

    yield shifted
    layout.offsets.cache_clear()


FIELDS = {*layout.OPTION_FIELDS, *layout.MODEL_FIELDS, *layout.DATA_FIELDS} - {"nplugin"}
"""After nplugin comes npluginattr, which is equal to it if no plugin has attributes."""


@pytest.mark.parametrize("field", sorted(FIELDS))
def test_a_field_at_another_offset_is_refused(field, shift):
    shift(field)
    with pytest.raises(RuntimeError, match=f"keeps {field} elsewhere than it declares"):
        layout.offsets()


@pytest.mark.parametrize("name", layout.content_spans())
def test_content_spans_match_the_arrays_of_models(name):
    """The address, the number of rows and their size, in models with several rows."""
    robot = MODELS / "articulated.xml"
    for compiled in (mujoco.MjModel.from_xml_path(str(robot)), model(custom=WAVES)):
        span, found = layout.content_spans()[name], getattr(compiled, name)
        rows = ctypes.c_int32.from_address(compiled._address + span.counter).value
        address = ctypes.c_int64.from_address(compiled._address + span.pointer).value
        if isinstance(found, bytes):
            assert ctypes.string_at(address, rows * span.row_size) == found
        else:
            assert address == found.ctypes.data or found.size == 0
            assert rows * span.row_size == found.nbytes


def test_models_with_fields_at_other_offsets_are_refused(shift, capfd):
    shift("cvel")
    with pytest.raises(ValueError, match="keeps cvel elsewhere than it declares"):
        model(custom='<numeric name="water_level" data="-0.125"/>')
    assert "RuntimeError" in capfd.readouterr().err
