"""The motion of a mode with a joint, integrated in C without any code of jbw.

The numbers of a `Plant` may have any units: plants with a frequency of 1 rad/s and a length of one
are drawn, and converted to hertz and metres when records are written.
"""

import ctypes
import hashlib
import os
import shutil
import subprocess
import tempfile
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
SOURCE = Path(__file__).with_name("osc.c")
# Sums may be reordered, so that several sliders are advanced at once; NaN stays NaN.
FLAGS = (
    "-O3", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-fno-signed-zeros",
    "-fassociative-math", "-shared", "-fPIC",
)  # fmt: skip
# Smallest number of RK4 steps per period. Kinks of a joint cause errors of the frequency of up to
# 1e-4 with 180 steps, and of 1e-5 with 720.
STEPS_A_PERIOD = 720
NUM_STATES, NUM_OUT, MOST_SLIDERS = 7, 6, 1024


@dataclass(frozen=True)
class Plant:
    """A mode and its joint, per unit modal mass; fields are in the order of `osc.c`.

    Attributes:
        omega_n: Natural frequency with the joint fully stuck, without elements behind a gap.
        zeta: Viscous damping ratio.
        springs: Stiffness of each slider.
        forces: Largest force of each slider.
    """

    omega_n: float = 1.0
    zeta: float = 0.0
    alpha: float = 0.0  # Bouc-Wen: dZ/dy = alpha - (gamma sgn(v Z) + delta) |Z|^nu
    delta: float = 0.0
    gamma: float = 0.0
    nu: float = 1.0
    gap: float = 0.0  # half of the free travel before a Bouc-Wen element of nu = 1
    gap_alpha: float = 0.0
    gap_delta: float = 0.0
    gap_gamma: float = 0.0
    quadratic: float = 0.0  # coefficient of y |y|
    square: float = 0.0  # coefficient of y^2
    cubic: float = 0.0
    quintic: float = 0.0
    stop: float = 0.0  # stiffness beyond stop_at on both sides
    stop_at: float = 0.0
    quadratic_damping: float = 0.0  # coefficient of v |v|
    cubic_damping: float = 0.0
    sigma_0: float = 0.0  # parameters of LuGre friction
    sigma_1: float = 0.0
    sigma_2: float = 0.0
    coulomb: float = 1.0
    static: float = 1.0
    stribeck: float = 1.0
    valanis_0: float = 0.0  # parameters E_0, E_t, lambda and kappa of Valanis' law
    valanis_t: float = 0.0
    valanis_lambda: float = 0.0
    valanis_kappa: float = 0.0
    kinetic: float = 1.0  # force of a sliding slider relative to its largest force
    drift: float = 0.0  # relative change of omega_n per unit of time
    armature_mass: float = 0.0  # mass of a shaker's armature over the modal mass
    armature_damping: float = 0.0
    armature_stiffness: float = 0.0
    omega_2: float = 1.0  # frequency of a second, linear mode
    zeta_2: float = 0.0
    gain_2: float = 0.0  # force on the second mode relative to that on the first
    springs: tuple[float, ...] = ()
    forces: tuple[float, ...] = ()

    @property
    def numbers(self) -> Array:
        """The parameters in the order of `osc.c`."""
        names = [field.name for field in fields(self)][:-2]
        return np.array([getattr(self, name) for name in names], float)

    @property
    def sliders(self) -> tuple[Array, Array]:
        """The stiffness and the largest force of each slider."""
        if len(self.springs) > MOST_SLIDERS:
            raise ValueError(f"A plant has at most {MOST_SLIDERS} sliders: {len(self.springs)}.")
        return np.array(self.springs, float), np.array(self.forces, float)


@cache
def library() -> ctypes.CDLL | None:
    """Return the compiled integrator, or None without a C compiler."""
    compiler = shutil.which("gcc") or shutil.which("cc") or shutil.which("clang")
    if compiler is None:
        return None
    words = SOURCE.read_bytes() + " ".join((compiler, *FLAGS)).encode()
    name = f"outside-{hashlib.sha256(words).hexdigest()[:16]}.so"
    folder = Path(tempfile.gettempdir()) / f"jbw-outside-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    if folder.stat().st_uid != os.getuid():  # any user may have made a folder of this name
        folder = Path(tempfile.mkdtemp())
    target = folder / name
    if not target.exists():
        # Another process may compile the same code: the finished file appears at once.
        unfinished = folder / f"{os.getpid()}-{name}"
        command = [compiler, *FLAGS, str(SOURCE), "-o", str(unfinished), "-lm"]
        subprocess.run(command, check=True)
        unfinished.rename(target)
    return ctypes.CDLL(str(target))


def march(
    plant: Plant,
    u: Array,
    fs: float,
    substeps: int,
    start: tuple[float, float] = (0.0, 0.0),
    *,
    pulled: bool = False,
) -> Array:
    """Integrate the motion under a given force.

    Args:
        plant: The mode and its joint.
        u: Force per unit modal mass at every half step, 2 substeps (n - 1) + 1 values for n
            samples.
        fs: Sampling frequency.
        substeps: Steps of RK4 a sample.
        start: Displacement and velocity at the first sample.
        pulled: Whether the joint was pulled slowly to the first displacement; otherwise it
            carries no force there, as where a blow began.

    Returns:
        Displacement, velocity and acceleration of the mode, then of the second mode, (6, n).

    Raises:
        FloatingPointError: The motion grows without bound.
        RuntimeError: There is no C compiler.
    """
    count = (u.size - 1) // (2 * substeps) + 1
    state = np.zeros(NUM_STATES)
    state[:2] = start
    out = np.empty((count, NUM_OUT))
    springs, forces = plant.sliders
    lost = _loops().march(
        _p(np.ascontiguousarray(u, float)), ctypes.c_long(count), substeps,
        ctypes.c_double(1 / (fs * substeps)), _p(plant.numbers), _p(springs), _p(forces),
        springs.size, _p(state), int(pulled), _p(out),
    )  # fmt: skip
    if lost:
        raise FloatingPointError("The motion grows without bound.")
    return out.T


def force_along(plant: Plant, y: Array, v: Array, fs: float, substeps: int) -> Array:
    """Return the restoring force per unit modal mass along a displacement.

    Args:
        plant: The mode and its joint, at rest before.
        y: Displacement at every half step, 2 substeps (n - 1) + 1 values for n samples.
        v: Velocity at the same times.
        fs: Sampling frequency.
        substeps: Steps of RK4 a sample.

    Raises:
        FloatingPointError: The force grows without bound.
        RuntimeError: There is no C compiler.
    """
    count = (y.size - 1) // (2 * substeps) + 1
    out = np.empty(count)
    springs, forces = plant.sliders
    lost = _loops().along(
        _p(np.ascontiguousarray(y, float)), _p(np.ascontiguousarray(v, float)),
        ctypes.c_long(count), substeps, ctypes.c_double(1 / (fs * substeps)), _p(plant.numbers),
        _p(springs), _p(forces), springs.size, _p(out),
    )  # fmt: skip
    if lost:
        raise FloatingPointError("The force grows without bound.")
    return out


def free_decay(
    plant: Plant, count: int, per_period: float, start: tuple[float, float], *, pulled: bool = False
) -> Array:
    """Integrate a free decay of a plant of about 1 rad/s, in `per_period` samples: (6, n)."""
    substeps = substeps_of(per_period)
    u = np.zeros(2 * substeps * (count - 1) + 1)
    return march(plant, u, per_period / (2 * np.pi), substeps, start, pulled=pulled)


def substeps_of(per_period: float) -> int:
    """Return the RK4 steps per sample for a given number of samples per period."""
    return max(int(np.ceil(STEPS_A_PERIOD / per_period)), 2)


def _p(values: Array) -> ctypes.c_void_p:
    return ctypes.c_void_p(values.ctypes.data)


def _loops() -> ctypes.CDLL:
    loops = library()
    if loops is None:
        raise RuntimeError(
            "The simulator needs a C compiler, but neither gcc, cc nor clang was found. "
            "Install one, for example by `apt install gcc`."
        )
    return loops
