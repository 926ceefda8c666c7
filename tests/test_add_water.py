"""Models without water that add_water or Scene.load makes float."""

import mujoco
import numpy as np
import pytest
from scenes import CUBE, WATER, WAVES, model, xml

from sim import Buoyancy, ModelError, Scene, add_water

DRY = f"""
<mujoco model="dry">
  <custom><numeric name="gain" data="1 2"/></custom>
  <worldbody>{CUBE}
    <body name="arm" pos="3 0 0"><freejoint/><geom type="sphere" size="0.2" density="500"/>
      <body name="hand" pos="0.5 0 0"><joint/><geom size="0.1" density="500"/></body></body>
  </worldbody>
</mujoco>"""


def floating(spec: mujoco.MjSpec) -> tuple[str, ...]:
    return Buoyancy.of(spec.compile()).body_names


def test_bodies_float_with_their_descendants():
    assert floating(add_water(mujoco.MjSpec.from_string(DRY), "arm")) == ("arm", "hand")
    assert floating(add_water(mujoco.MjSpec.from_string(DRY), "hand", "cube")) == ("cube", "hand")


def test_bodies_join_those_that_float_already_and_only_once():
    spec = add_water(mujoco.MjSpec.from_string(DRY), "cube")
    for _ in range(2):
        spec = add_water(spec, "arm")
    compiled = spec.compile()
    assert Buoyancy.of(compiled).body_names == ("cube", "arm", "hand")
    assert compiled.nplugin == 1


def test_a_file_stays_unchanged_and_a_spec_is_changed_in_place(tmp_path):
    path = tmp_path / "dry.xml"
    path.write_text(DRY)
    assert floating(add_water(path, "cube")) == floating(add_water(str(path), "cube")) == ("cube",)
    assert path.read_text() == DRY
    spec = mujoco.MjSpec.from_string(DRY)
    assert add_water(spec, "cube") is spec
    with pytest.raises(FileNotFoundError, match=r"no scene file .*nowhere\.xml"):
        add_water(tmp_path / "nowhere.xml", "cube")


def test_fields_act_like_those_of_a_file():
    """Numbers, rows, matrices and texts. New values replace old ones, and other fields stay."""
    spec = add_water(
        mujoco.MjSpec.from_string(DRY), "cube", water_density=1000, wave_swell=(0.1, 4, 0, 0),
        damping=np.eye(6).ravel(), buoyancy_method="linear",
    )  # fmt: skip
    add_water(spec, water_density=[1025.0])
    numbers = " ".join(map(str, np.eye(6).ravel()))
    custom = (
        f'<numeric name="wave_swell" data="0.1 4 0 0"/><numeric name="damping" data="{numbers}"/>'
        '<text name="buoyancy_method" data="linear"/>'
    )
    found, expected = Buoyancy.of(spec.compile()), Buoyancy.of(model(custom=custom))
    assert (found.sea.density, found.sea.waves) == (expected.sea.density, expected.sea.waves)
    assert type(found.floats[0].method) is type(expected.floats[0].method)
    np.testing.assert_array_equal(found.floats[0].drag.damping, expected.floats[0].drag.damping)
    assert spec.compile().numeric("gain").data.tolist() == [1.0, 2.0]


def test_all_faults_are_reported_at_once():
    with pytest.raises(ModelError) as caught:
        add_water(
            mujoco.MjSpec.from_string(DRY), "torso", "cube", wave_swell=(0.1, 4), drag="strong",
            water_tint=3, buoyancy_metod="linear", buoyancy_method=3, water_density=-1.0,
        )  # fmt: skip
    faults = caught.value.faults
    for text in ("no body 'torso'; the model has cube, arm, hand", "'wave_swell' has 2 numbers",
                 "field 'drag': 'strong' is not a row of numbers", "'water_tint' is unknown",
                 "field 'buoyancy_metod'", "field 'buoyancy_method': it takes a text, not 3",
                 "the water density is -1"):  # fmt: skip
        assert sum(text in fault for fault in faults) == 1, text
    assert len(faults) == 7


def test_a_spec_floats_like_its_file(tmp_path):
    """With or without the plugin in the file; Scene.load adds it."""
    path, dry = tmp_path / "wet.xml", tmp_path / "dry.xml"
    path.write_text(xml(custom=WAVES))
    dry.write_text(xml(custom=WAVES).replace(WATER, ""))
    ends = []
    for source in (
        path, dry, mujoco.MjSpec.from_file(str(path)), mujoco.MjSpec.from_file(str(dry)),
        add_water(dry),
    ):  # fmt: skip
        scene = Scene.load(source)
        mujoco.mj_step(scene.model, scene.data, nstep=30)
        ends.append(scene.data.qpos.copy())
        assert scene.model.nplugin == 1
    np.testing.assert_array_equal(ends, [ends[0]] * len(ends))
    assert dry.read_text() == xml(custom=WAVES).replace(WATER, "")


def test_the_plugin_survives_saving_and_loading(tmp_path):
    compiled = model(custom=WAVES)
    mujoco.mj_saveModel(compiled, str(tmp_path / "m.mjb"), None)
    add_water(xml_file(tmp_path), "cube").compile()
    again = mujoco.MjModel.from_binary_path(str(tmp_path / "m.mjb"))
    ends = []
    for each in (compiled, again):
        data = mujoco.MjData(each)
        mujoco.mj_step(each, data, nstep=30)
        ends.append(data.qpos.copy())
    np.testing.assert_array_equal(*ends)
    spec = add_water(xml_file(tmp_path), "cube", wave_swell=(0.1, 4, 0, 0))
    spec.compile()
    written = mujoco.MjModel.from_xml_string(spec.to_xml())
    assert Buoyancy.of(written).sea.waves == Buoyancy.of(spec.compile()).sea.waves


def xml_file(folder):
    path = folder / "dry.xml"
    path.write_text(DRY)
    return path


URDF = """<robot name="r"><link name="base">
  <inertial><mass value="60"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
  <collision><geometry><box size="1 0.5 0.2"/></geometry></collision></link></robot>"""


def test_a_urdf_with_a_fixed_base_floats(tmp_path):
    (tmp_path / "robot.urdf").write_text(URDF)
    compiled = add_water(tmp_path / "robot.urdf", "base").compile()
    data = mujoco.MjData(compiled)
    data.qpos[2] = 0.1 - 60.0 / (1025.0 * 0.5)
    mujoco.mj_forward(compiled, data)
    np.testing.assert_allclose(data.xfrc_applied[1, 2], 60.0 * 9.81, rtol=1e-9)
