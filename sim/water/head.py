"""Head: the pressure of the water over density * gravity, in metres; the one definition of it.

Everything that needs a pressure asks here: kernels by `head` for a single place whose water they
know, or `solve_heads` for many; the rest of the package by `Sea.head`, which does the same. The
patches' cubic of the head is made from the jets of the same surface (`jets`).

It is hydrostatic below the instantaneous surface: the depth below the surface right above.
"""

from sim.kernels import inline, kernel
from sim.water.gerstner import solve_heights


def hydrostatic(height, above):
    """Head [m] at a place so far above the still level [m], where the surface is at a height [m]
    above it: positive under water, zero on the surface."""
    return height - above


head = inline(hydrostatic)


@kernel
def solve_heads(x, y, z, waves, water, time, heads_out):
    """Heads (N,) [m] at the points x, y, z: (N,) [m], from one solve each."""
    solve_heights(x, y, waves, time, water[0].tolerance, heads_out)
    for i in range(x.size):  # until here these are the heights
        heads_out[i] = head(heads_out[i], z[i] - water[0].level)
