"""Compute buoyancy, by two methods, and drag on a hull at a pose, without a MuJoCo scene."""

import numpy as np
import trimesh

from sim import Drag, DragCoefficients, Hull, Patches, Reference, Sea, Wave

sea = Sea([Wave(amplitude=0.3, wavelength=8.0), Wave(0.1, 3.0, heading=np.radians(50.0))])
hull = Hull.from_trimesh(trimesh.creation.capsule(height=2.0, radius=0.4))
position, rotation, time = np.array([0.5, 0.0, -0.1]), np.eye(3), 1.5

for method in (Patches(hull, sea), Reference(hull, sea)):
    wrench = method.wrench(position, rotation, time)  # about the position, world axes
    print(
        f"{type(method).__name__:<10} force {wrench[:3].round(2)} N, torque {wrench[3:].round(2)}"
    )

drag = Drag(hull, sea, DragCoefficients(linear=0.2, form=1.0, friction=0.005))
velocity = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.2])  # m/s, rad/s
print(f"Drag       force {drag.wrench(position, rotation, velocity, time)[:3].round(2)} N")
print(f"elevation {float(sea.elevation(0.5, 0.0, time)):.3f} m above the position")
