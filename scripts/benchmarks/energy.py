"""Energy of bodies and of the flat water that they displace."""

import mujoco
import numpy as np

from sim.scenes.scene import Scene


def potential_energy(scene: Scene) -> float:
    """Potential energy [J] of flat water and the bodies in it, relative to the water's level.

    The energy of the water is density * g times the integral of the depth over the submerged
    volume. By Gauss's theorem that integral equals the integral of -depth^2 / 2 n_z over the wet
    surface. Over a triangle with depths a, b, c the integral of depth^2 is
        area (a^2 + b^2 + c^2 + ab + bc + ca) / 6.
    Where the surface separates a corner with depth d from corners with depths e and f, the share of
    that corner is area d^4 / (6 (d - e) (d - f)).
    """
    model, data, sea = scene.model, scene.data, scene.buoyancy.sea
    total = float(model.body_mass @ (data.xipos[:, 2] - sea.level)) * sea.gravity
    for f in scene.buoyancy.floats:
        hull = f.method.hull
        up = data.geom_xmat[f.geom].reshape(3, 3)[2]
        depth = (sea.level - hull.vertices @ up - data.geom_xpos[f.geom, 2])[hull.faces]
        wet = depth > 0.0
        odd = np.argmax(wet == (wet.sum(axis=1) == 1)[:, None], axis=1)
        d, e, c = (depth[np.arange(len(depth)), (odd + i) % 3] for i in range(3))
        whole = (depth**2).sum(axis=1) + d * e + e * c + c * d
        cut = wet.any(axis=1) & ~wet.all(axis=1)
        corner = np.where(cut, d**4 / np.where(cut, (d - e) * (d - c), 1.0), 0.0)
        integral = np.select(
            [wet.all(axis=1), wet.sum(axis=1) == 1, cut], [whole, corner, whole - corner], 0.0
        )
        displaced = f.displaced * sea.density * sea.gravity
        total -= 0.5 * displaced * float(integral / 6.0 @ (hull.area_vectors @ up))
    return total


def mechanical_energy(scene: Scene) -> float:
    """Kinetic plus potential energy [J] of the scene's present state."""
    mujoco.mj_forward(scene.model, scene.data)
    mujoco.mj_energyVel(scene.model, scene.data)
    return float(scene.data.energy[1]) + potential_energy(scene)
