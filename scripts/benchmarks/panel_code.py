"""Panel code: linear potential theory by Capytaine (extra `bem`), used only for validation.

Source: Ancellin and Dias 2019, Capytaine: a Python-based linear potential flow solver.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.hulls.hull import Hull

Array = NDArray[np.float64]

MOTIONS = ("Surge", "Heave", "Pitch")


def floating_body(hull: Hull, centre: tuple[float, float, float]) -> Any:
    """Capytaine's body of a hull with its waterline at z = 0 and its centre of mass (3,) [m]."""
    import capytaine

    capytaine.set_logging("ERROR")
    quadrangles = np.hstack([hull.faces, hull.faces[:, 2:]])
    mesh = capytaine.Mesh(hull.vertices, quadrangles).immersed_part()
    body = capytaine.FloatingBody(mesh=mesh, center_of_mass=centre)
    body.add_all_rigid_body_dofs()
    return body


def radiation(body: Any, omega: float, density: float, gravity: float) -> tuple[Array, Array]:
    """Added mass and damping (3, 3), both in the order of MOTIONS, at a frequency [rad/s]."""
    import capytaine

    found = [
        capytaine.BEMSolver().solve(
            capytaine.RadiationProblem(
                body=body, radiating_dof=motion, omega=omega, rho=density, g=gravity
            )
        )
        for motion in MOTIONS
    ]
    added = np.array([[f.added_masses[m] for m in MOTIONS] for f in found])
    damping = np.array([[f.radiation_dampings[m] for m in MOTIONS] for f in found])
    return 0.5 * (added + added.T), 0.5 * (damping + damping.T)


def response(
    body: Any, omega: float, mass: Array, stiffness: Array, density: float, gravity: float
) -> Array:
    """Amplitudes (2,) of heave [m/m] and pitch [rad/m] in head waves of a frequency [rad/s].

    The body is free in heave and pitch only. Its mass and stiffness matrices are (2, 2).
    """
    import capytaine

    added, damping = (m[1:, 1:] for m in radiation(body, omega, density, gravity))
    problem = capytaine.DiffractionProblem(
        body=body, omega=omega, wave_direction=np.pi, rho=density, g=gravity
    )
    scattered = capytaine.BEMSolver().solve(problem).forces
    incident = capytaine.bem.airy_waves.froude_krylov_force(problem)
    force = np.array([scattered[m] + incident[m] for m in MOTIONS[1:]])
    left = stiffness - omega**2 * (mass + added) - 1j * omega * damping
    return np.abs(np.linalg.solve(left, force))
