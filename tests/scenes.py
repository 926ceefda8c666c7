"""Small MJCF models for the tests."""

from typing import Any

import mujoco

from sim import Scene

WATER = '<extension><plugin plugin="waterline"><instance name="water"/></plugin></extension>'

WAVES = """
    <numeric name="wave_swell" data="0.10 4.0 0 0"/>
    <numeric name="wave_cross" data="0.06 2.4 55 40"/>
    <numeric name="wave_chop" data="0.03 1.4 -65 110"/>"""

CUBE = """
    <body name="cube" pos="0 0 0">
      <freejoint/>
      <geom name="cube" type="box" size="0.5 0.5 0.5" density="512.5"/>
    </body>"""


def xml(
    bodies: str = CUBE,
    buoyant: tuple[str, ...] = ("cube",),
    custom: str = "",
    option: str = '<option timestep="0.005"/>',
    assets: str = "",
    extra: str = "",
) -> str:
    """An MJCF model whose named geoms float. The water is flat unless `custom` has waves."""
    elements = "".join(f'<element objtype="geom" objname="{g}" prm="0"/>' for g in buoyant)
    listed = f'<tuple name="buoyant">{elements}</tuple>' if buoyant else ""
    return f"""<mujoco model="test">
  {WATER}
  {option}
  <custom>
    <numeric name="water_density" data="1025"/>{custom}
    {listed}
  </custom>
  <asset>{assets}</asset>
  <worldbody>{bodies}
  </worldbody>
  {extra}
</mujoco>"""


def model(*args, **kwargs) -> mujoco.MjModel:
    """The compiled model of `xml` with the same arguments."""
    return mujoco.MjModel.from_xml_string(xml(*args, **kwargs))


def afloat(*args, load: dict[str, Any] | None = None, **kwargs) -> Scene:
    """The scene of `xml` with the same arguments. load: keyword arguments of `Scene.load`."""
    return Scene.load(mujoco.MjSpec.from_string(xml(*args, **kwargs)), **(load or {}))
