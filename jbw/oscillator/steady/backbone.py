r"""Resonance against amplitude, frequency response, and motion at controlled amplitude or phase.

In a controlled motion the first harmonic is given, and its force is the unknown. One force may have
several motions, but one motion has only one force: along the amplitude there is no choice of branch
and no fold. In the harmonic balance R_n(q) = u_n (`balance.imbalance`, without a load), q_1 = Y is
given and the higher harmonics remain unknown,

$$R_n(Y, q_3, q_5, \dots) = 0, \quad n = 3, 5, \dots, \qquad
  F_1 e^{-j\varphi} = R_1(Y, q_3, q_5, \dots)$$

with phi the phase of the displacement relative to the force. Where the phase is controlled too, the
frequency is one more unknown, and the condition that determines it is that the force has that
phase, $\mathrm{Im}\,(R_1 e^{j\varphi}) = 0$.
"""

from functools import partial
from typing import Any, overload

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Complex, Float, Real

from jbw.oscillator.checks import (
    require_at_least,
    require_contracts,
    require_finite,
    require_periodic,
    require_sense,
)
from jbw.oscillator.modes.backbone import ModalBackbone, modal_backbone
from jbw.oscillator.modes.balance import StructureHarmonics
from jbw.oscillator.modes.structure import Structure
from jbw.oscillator.oscillator import Joint, Oscillator, as_oscillator
from jbw.oscillator.parameters import Scalar, batched
from jbw.oscillator.steady.balance import (
    Packed,
    dimensionless,
    imbalance,
    linear_response,
    newton_steps,
    tone_from,
)
from jbw.oscillator.steady.cycle import converged
from jbw.oscillator.steady.modal import modal_tones
from jbw.oscillator.steady.waveform import orders

NUM_HARMONICS = 4
# Number of Newton steps that start from a motion of one harmonic; each step squares the error.
NUM_STEPS = 3


class Backbone(eqx.Module):
    """The resonance of the joint against amplitude.

    Attributes:
        y_peak: Displacement amplitude Y [m].
        omega: Resonance frequency, where y lags the force by 90 degrees [rad/s].
        zeta: Equivalent damping ratio at resonance, viscous and hysteretic [-].
        amplitude: Force amplitude that sustains Y at resonance [N/kg].
    """

    y_peak: Float[Array, "..."]
    omega: Float[Array, "..."]
    zeta: Float[Array, "..."]
    amplitude: Float[Array, "..."]


@overload
def backbone(
    joint: Structure,
    y_peak: ArrayLike,
    *,
    mode: int = 0,
    num_harmonics: int = 8,
    max_turns: int = 2,
) -> ModalBackbone: ...
@overload
def backbone(joint: Joint, y_peak: ArrayLike) -> Backbone: ...
def backbone(
    joint: Joint | Structure,
    y_peak: Real[ArrayLike, "..."],
    *,
    mode: int = 0,
    num_harmonics: int = 8,
    max_turns: int = 2,
) -> Backbone | ModalBackbone:
    r"""Return resonance frequency and equivalent damping at each amplitude, from the steady loop.

    For y = Y cos(theta) and the balance of the first harmonic alone, phase resonance needs

    $$\omega^2 = k + \frac{\mathrm{Re}\,F_1}{Y}, \qquad
      A = 2\zeta\omega_n\omega Y + \frac{E}{\pi Y} = 2\zeta_{eq}\,\omega^2 Y$$
    $$\zeta_{eq} = \zeta\,\frac{\omega_n}{\omega} + \frac{E}{2\pi\omega^2 Y^2}$$

    with F_1 the first harmonic of the laws' forces, 3 lambda_3 Y^3/4 for a cubic spring, and E the
    energy that their loops dissipate per cycle. Neglecting the higher harmonics causes a relative
    error of 2e-5 to 2.5e-4 in Y for the joint of Teloli et al.

    For a `Structure` the result is the extended periodic motion of one of its modes, followed from
    the fully stuck joints. Its amplitude is the first harmonic X of the joint's displacement or,
    where `h` has one row per joint, that of the mode's own coordinate, |q_1|:

    $$\ddot q_i + (2\zeta_i\omega_i - 2\zeta_{eq}\omega)\dot q_i + \omega_i^2 q_i
      + \sum_j p_{ij} r_j = 0$$

    Args:
        joint: A `BoucWen` with nu = 1, an `Oscillator` with any laws, or a `Structure`.
        y_peak: Displacement amplitudes Y [m]; for a `Structure` X or |q_1|. At 0 the joint is fully
            stuck.
        mode: Index of the mode of a `Structure`, from 0.
        num_harmonics: Number of odd harmonics for a `Structure`; other joints use only the first.
        max_turns: Largest number of turning points of every joint of a `Structure` in a period.

    Returns:
        The backbone at each amplitude; for a `Structure` with deflection shape and harmonics.

    Raises:
        ModelError: `nu` is not 1, a spring other than `square` has an even part, or a
            concrete argument is not finite.
        ConfigError: `y_peak` is negative.

    Reference:
        Z_1 and E close Eqs. (3)-(6).

    Examples:
        Frequency falls and damping rises with the amplitude:

        >>> import jbw; jbw.enable_x64()
        >>> import numpy as np
        >>> joint = jbw.BoucWen(omega_n=118.12, zeta=0.00444, alpha=497.4, delta=340.2, gamma=32.8)
        >>> curve = jbw.backbone(joint, np.array([0.0, 0.5e-3, 1e-3]))
        >>> print((curve.omega / (2 * np.pi)).round(2), "Hz,", (100 * curve.zeta).round(2), "%")
        [18.8  18.78 18.76] Hz, [0.44 0.46 0.47] %
    """
    if isinstance(joint, Structure):
        return modal_backbone(
            joint, y_peak, mode=mode, num_harmonics=num_harmonics, max_turns=max_turns
        )
    stated_joint, joint = joint, as_oscillator(joint)
    _require_loops(stated_joint)
    require_finite(stated_joint, y_peak=y_peak)
    require_at_least("y_peak", y_peak, 0.0)
    y_peak = jnp.asarray(y_peak, float)
    loop = joint.loop(y_peak)
    omega_squared = joint.k + loop.stiffness
    omega = jnp.sqrt(omega_squared)
    zeta = joint.zeta * joint.omega_n / omega + loop.damping / (2.0 * omega_squared)
    amplitude = 2.0 * zeta * omega_squared * y_peak
    return Backbone(*jnp.broadcast_arrays(y_peak, omega, zeta, amplitude))


def _require_loops(joint: Any) -> None:
    """Raise if a law has no equivalent stiffness and damping at a given amplitude."""
    require_contracts(joint)
    for law in joint.laws:
        if not law.is_even:  # `Oscillator.loop` includes the second-order effect of even laws
            law.check_periodic()


@overload
def frequency_response(
    joint: Structure, omega: ArrayLike, amplitude: ArrayLike, num_harmonics: int = 8, **options: Any
) -> StructureHarmonics: ...
@overload
def frequency_response(
    joint: Joint, omega: ArrayLike, amplitude: ArrayLike, num_harmonics: int = 8, **options: Any
) -> Complex[Array, "... freq harmonic"]: ...
def frequency_response(  # pyright: ignore[reportInconsistentOverload]
    joint: Joint | Structure,
    omega: Float[Array, " freq"],
    amplitude: Real[ArrayLike, "..."],
    num_harmonics: int = 8,
    *,
    max_turns: int = 2,
) -> Complex[Array, "... freq harmonic"] | StructureHarmonics:
    r"""Return the odd harmonics at each frequency; each solution starts from the previous one.

    The solutions are those of `steady_state`, reached as a slow stepped sine reaches them: Newton's
    iteration starts from the harmonics at the previous frequency, or raises the load in steps where
    that fails. Where several responses exist the order of `omega` decides, so a falling sweep may
    differ from a rising one, as on the rig. Differentiable like `steady_state`.

    Args:
        joint: A `BoucWen` with nu = 1, or an `Oscillator`; it broadcasts against `amplitude`. For a
            `Structure`, the harmonics of joint, modes and outputs are returned.
        omega: Angular frequencies in the order of the sweep [rad/s].
        amplitude: Force amplitudes A, one per level [N/kg].
        num_harmonics: Number of odd harmonics.
        max_turns: Turning points of y allowed in a period, as for `steady_state`.

    Returns:
        Complex peak amplitudes of orders 1, 3, 5, ... [m]; NaN where not converged.

    Raises:
        ModelError, ConfigError: As for `steady_state`.

    Reference:
        In place of Eqs. (19)-(31).

    Examples:
        A stepped sine of 0.5 N/kg peaks below the 18.80 Hz of weak motion:

        >>> import jbw; jbw.enable_x64()
        >>> import numpy as np
        >>> joint = jbw.BoucWen(omega_n=118.12, zeta=0.00444, alpha=497.4, delta=340.2, gamma=32.8)
        >>> hz = np.linspace(17.5, 19.5, 81)
        >>> y = abs(jbw.frequency_response(joint, 2 * np.pi * hz, amplitude=0.5)[:, 0])
        >>> print(f"{1e3 * y.max():.2f} mm at {hz[y.argmax()]:.2f} Hz")
        3.38 mm at 18.68 Hz
    """
    omega = jnp.asarray(omega, float)
    if isinstance(joint, Structure):
        return modal_tones(joint, omega, amplitude, num_harmonics, max_turns, swept=True)
    require_sense(joint, omega, amplitude, num_harmonics, max_turns)
    solve = partial(_sweep, as_oscillator(joint), omega, amplitude, num_harmonics)
    joint, amplitude = jax.tree.map(lambda leaf: jnp.asarray(leaf)[..., None], (joint, amplitude))
    # pyright: ignore[reportArgumentType]
    return converged(solve, joint, omega, amplitude, max_turns)  # pyright: ignore[reportArgumentType]


@partial(jax.jit, static_argnums=(3, 4))
def _sweep(
    joint: Oscillator,
    omega: Float[Array, " freq"],
    amplitude: ArrayLike,
    num_harmonics: int,
    max_turns: int,
) -> tuple[Array, Array]:
    def level(joint: Oscillator, amplitude: Array) -> tuple[Array, Array]:
        unit, ratio, length = dimensionless(joint, omega, amplitude)

        def tone(before: Packed, ratio: Array) -> tuple[Packed, tuple[Array, Array]]:
            return tone_from(before, unit, ratio, length, max_turns)

        return jax.lax.scan(tone, linear_response(unit, ratio[0], num_harmonics), ratio)[1]

    return batched(level, joint, amplitude)


def force_at(
    joint: Joint,
    omega: Scalar,
    y_peak: Scalar,
    num_harmonics: int = NUM_HARMONICS,
    num_steps: int = NUM_STEPS,
) -> Complex[Array, ""]:
    r"""Return the fundamental force per mass that sustains an amplitude at a frequency [N/kg].

    $$F_1 e^{-j\varphi} = (\omega_n^2 - \omega^2 + 2j\zeta\omega_n\omega)\,Y + \sum r_1(q)$$

    Its phase is relative to the displacement. Without higher harmonics this is the describing
    function of the laws; the higher harmonics add about 1e-4 of the damping's part.

    Args:
        joint: A `BoucWen` with nu = 1, or an `Oscillator`, scalars.
        omega: Angular frequency [rad/s].
        y_peak: Amplitude Y of the displacement's fundamental [m], positive.
        num_harmonics: Number of odd harmonics that are balanced.
        num_steps: Number of Newton steps.

    Raises:
        ModelError: nu is not 1, or a spring has an even part.
    """
    joint = as_oscillator(joint)
    require_periodic(joint)

    def imbalance(x: Float[Array, " unknown"]) -> Float[Array, " unknown"]:
        return _split(_imbalance(joint, omega, y_peak, x)[1:])

    x = newton_steps(imbalance, jnp.zeros(2 * num_harmonics - 2), num_steps)
    return jnp.asarray(y_peak * _imbalance(joint, omega, y_peak, x)[0])


def tone_at_phase(
    joint: Joint,
    y_peak: Scalar,
    phase: Scalar,
    num_harmonics: int = NUM_HARMONICS,
    num_steps: int = NUM_STEPS,
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    r"""Return the frequency [rad/s] and force amplitude [N/kg] for a given amplitude and phase.

    For y = Y cos(theta), with the laws' stiffness K and damping C at amplitude Y, the first
    harmonic gives

    $$\omega = \zeta\omega_n \cot\varphi +
        \sqrt{(\zeta\omega_n \cot\varphi)^2 + k + K + C\cot\varphi}, \qquad
      F = -\frac{2\zeta\omega_n\omega + C}{\sin\varphi}\,Y$$

    from which Newton's iteration finds the higher harmonics. At -90 degrees the result is the
    backbone.

    Args:
        joint: A `BoucWen` with nu = 1, or an `Oscillator`, scalars.
        y_peak: Amplitude Y of the displacement's fundamental [m], positive.
        phase: Phase of the displacement relative to the force [rad], between -pi and 0.
        num_harmonics: Number of odd harmonics that are balanced.
        num_steps: Number of Newton steps.

    Raises:
        ModelError: nu is not 1, or a spring has an even part.
    """
    joint = as_oscillator(joint)
    require_periodic(joint)
    turn = jax.lax.complex(jnp.cos(phase), jnp.sin(phase))

    def imbalance(x: Float[Array, " unknown"]) -> Float[Array, " unknown"]:
        r = _imbalance(joint, x[-1] * joint.omega_n, y_peak, x[:-1])
        return jnp.append(_split(r[1:]), jnp.imag(r[0] * turn)) / joint.omega_n**2

    none = jnp.zeros(2 * num_harmonics - 2)
    cotangent = jnp.cos(phase) / jnp.sin(phase)
    # At omega_n the first harmonic is 2 j zeta omega_n^2 plus the laws' contribution.
    law = _imbalance(joint, joint.omega_n, y_peak, none)[0] - 2j * joint.zeta * joint.omega_n**2
    half = joint.zeta * joint.omega_n * cotangent
    squared = joint.omega_n**2 + jnp.real(law) + jnp.imag(law) * cotangent
    omega = half + jnp.sqrt(half**2 + squared)
    x = newton_steps(imbalance, jnp.append(none, omega / joint.omega_n), num_steps)
    force = _imbalance(joint, x[-1] * joint.omega_n, y_peak, x[:-1])[0]
    return x[-1] * joint.omega_n, y_peak * jnp.abs(force)  # pyright: ignore[reportReturnType]


def _imbalance(
    joint: Joint, omega: Scalar, y_peak: Scalar, x: Float[Array, " unknown"]
) -> Complex[Array, " harmonic"]:
    """Return the residual of harmonic balance; its harmonics are relative to the amplitude Y."""
    real, imaginary = jnp.split(x, 2)
    higher = jax.lax.complex(real, imaginary)
    q = jnp.asarray(y_peak * jnp.concatenate([jnp.ones(1, complex), higher]))
    return imbalance(joint, omega, q, 0.0 * orders(q.shape[0])) / y_peak


def _split(values: Complex[Array, " harmonic"]) -> Float[Array, " part"]:
    return jnp.concatenate([values.real, values.imag])
