"""Draw the figures of the pages in docs/theory, from `jbw.paper` alone.

python docs/draw_theory.py
"""

from pathlib import Path

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import jbw
from jbw import paper, rig

FOLDER = Path(__file__).parent / "theory"
JOINT = rig.TRUTH
HZ = 2 * np.pi


def loop(axes):
    """The loop at 2.4 mm, its four branches and the cubic that replaces them."""
    y_peak = 2.4e-3
    y_0 = float(jbw.steady_loop(JOINT, y_peak).y_open)
    polynomial = paper.smoothing(JOINT, y_peak)
    left, right = axes
    spans = ((1, y_0, y_peak), (2, -y_peak, y_0), (3, -y_peak, -y_0), (4, -y_0, y_peak))
    for path, low, high in spans:
        y = np.linspace(low, high, 100)
        z = paper.branch(JOINT, y, y_0, path)
        left.plot(1e3 * y, z, label=f"({path + 2})")
        force = paper.unloading_force if path < 3 else paper.loading_force
        error = 1e3 * (force(polynomial, y) - z)
        right.plot(
            1e3 * y, error, label="unloading" if path < 3 else "loading", color=f"C{path - 1}"
        )
    y = np.linspace(-y_peak, y_peak, 200)
    left.plot(1e3 * y, paper.unloading_force(polynomial, y), "k:", label="(8)")
    left.plot(1e3 * y, paper.loading_force(polynomial, y), "k--", label="(7)")
    left.set(xlabel="displacement [mm]", ylabel="hysteretic force [N/kg]")
    left.legend(fontsize=7)
    right.set(xlabel="displacement [mm]", ylabel="cubic less branch [mN/kg]")


def square_wave(axes):
    """The additional input by its sum, and the force by both switchings."""
    left, right = axes
    theta = np.linspace(0, 4 * np.pi, 800)
    for terms in (1, 2, 8, 64):
        left.plot(
            theta / np.pi, paper.square_wave(1.0, theta, num_terms=terms), lw=0.9, label=f"{terms}"
        )
    left.set(xlabel="phase of y / π", ylabel="u₀ / λ₀")
    left.legend(title="terms", fontsize=7)
    polynomial = paper.smoothing(JOINT, 2.4e-3)
    y, v = np.cos(theta), -np.sin(theta)
    for lag, name in ((0.0, "dy/dt"), (np.pi / 2, "du/dt at resonance")):
        by = v if not lag else -np.sin(theta + lag)
        force = paper.smoothed_force(polynomial, 2.4e-3 * y, by)
        elastic = paper.smoothed_force(polynomial, 2.4e-3 * y, 0.0)
        right.plot(2.4 * y, force - elastic, lw=0.9, label=f"switched with {name}")
    right.set(xlabel="displacement [mm]", ylabel="switched force [N/kg]")
    right.legend(fontsize=7)


def kernels(axes):
    """H1, H2 and the leading diagonal of H3, with a constant quadratic term."""
    cubic = paper.cubic_oscillator(JOINT, paper.smoothing(JOINT, 0.8e-3))
    system = paper.PolynomialOscillator(cubic.damping, cubic.stiffness, 9e3, cubic.lambda_3)
    f = np.linspace(2.0, 24.0, 241)
    first, third = axes[0], axes[2]
    first.semilogy(f, np.abs(paper.kernel_1(system, HZ * f)))
    first.set(xlabel="frequency [Hz]", ylabel="|H₁| [s²]")
    grid = np.meshgrid(f, f)
    plane = np.abs(paper.kernel_2(system, HZ * grid[0], HZ * grid[1]))
    axes[1].pcolormesh(f, f, np.log10(plane), rasterized=True)
    axes[1].set(xlabel="f₁ [Hz]", ylabel="f₂ [Hz]", title="log₁₀ |H₂|")
    diagonal = paper.leading_diagonals(system, HZ * f, 3)[2]
    third.semilogy(f, np.abs(diagonal))
    third.set(xlabel="frequency [Hz]", ylabel="|H₃(ω,ω,ω)| [m⁻² s⁶]")


def describing(axes):
    """4 Y(3 omega)/A^3 of the true joint at three amplitudes, against (31) at the same motion."""
    f = np.linspace(4.6, 7.4, 113)
    for colour, amplitude in zip(("C0", "C1", "C2"), (3.0, 10.0, 20.0), strict=True):
        y = jbw.frequency_response(JOINT, jnp.asarray(HZ * f), amplitude)
        true = 4 * np.asarray(y[:, 1]) / amplitude**3
        printed = jbw.h3(JOINT, HZ * f, np.abs(y[:, 0]), variant="printed")
        axes[0].semilogy(f, np.abs(true), color=colour, label=f"A = {amplitude:g} N/kg")
        axes[0].semilogy(f, np.abs(printed), ":", color=colour)
        axes[1].plot(f, np.degrees(np.angle(true / printed)), color=colour)
    axes[0].set(xlabel="frequency [Hz]", ylabel="|H₃| [m⁻² s⁶]")
    axes[0].legend(title="solid: true, dotted: (31)", fontsize=7, title_fontsize=7)
    axes[1].set(xlabel="frequency [Hz]", ylabel="phase, true less (31) [°]", ylim=(-30, 30))


FIGURES = {"loop": (loop, 2), "square_wave": (square_wave, 2), "kernels": (kernels, 3)}
FIGURES["describing_function"] = (describing, 2)

if __name__ == "__main__":
    jbw.enable_x64()
    for name, (draw, count) in FIGURES.items():
        figure, axes = plt.subplots(1, count, figsize=(9, 3.2), layout="constrained")
        draw(axes)
        figure.savefig(FOLDER / f"{name}.png", dpi=100)
        print(name)
