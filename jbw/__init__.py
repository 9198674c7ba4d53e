"""jbw identifies bolted joints from vibration measurements.

The public names below load on first use, so `import jbw` is quick and changes no global state.
Results need float64: call `jbw.enable_x64()` before any array is made.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jbw import forced as forced
    from jbw import paper as paper
    from jbw import rig as rig
    from jbw.assembly.files.read import read_matrices as read_matrices
    from jbw.assembly.joint import Joint as Joint
    from jbw.assembly.matrices import MatrixModel as MatrixModel
    from jbw.assembly.matrices import matrix_model as matrix_model
    from jbw.assembly.reduce import ReducedModel as ReducedModel
    from jbw.assembly.reduce import reduce as reduce
    from jbw.assembly.separability import energy_shares as energy_shares
    from jbw.assembly.separability import joint_separability as joint_separability
    from jbw.assembly.starts import joint_starts as joint_starts
    from jbw.campaign.load import Campaign as Campaign
    from jbw.campaign.load import load_campaign as load_campaign
    from jbw.errors import ConfigError as ConfigError
    from jbw.errors import DataError as DataError
    from jbw.errors import JbwError as JbwError
    from jbw.errors import ModelError as ModelError
    from jbw.errors import RunError as RunError
    from jbw.forced.profiles import RandomProfile as RandomProfile
    from jbw.forced.profiles import profile_of as profile_of
    from jbw.forced.profiles import read_profile as read_profile
    from jbw.forced.shock import Pulse as Pulse
    from jbw.forced.shock import shock_spectrum as shock_spectrum
    from jbw.identification.linear import line_fit as line_fit
    from jbw.identification.linear import pool as pool
    from jbw.identification.modal import fit_modes as fit_modes
    from jbw.identification.paper import steps as steps
    from jbw.inference import sampling as sampling
    from jbw.lab.calibration import sbc as sbc
    from jbw.lab.samplers import compare as compare
    from jbw.law_comparison.compare import compare_laws as compare_laws
    from jbw.measurement.files.read import read as read
    from jbw.measurement.files.sep005 import from_sep005 as from_sep005
    from jbw.measurement.files.sep005 import to_sep005 as to_sep005
    from jbw.measurement.files.uff import write_uff as write_uff
    from jbw.measurement.harmonics import harmonics as harmonics
    from jbw.measurement.probing import third_order_kernel as third_order_kernel
    from jbw.measurement.records import Record as Record
    from jbw.measurement.records import Test as Test
    from jbw.measurement.shaker import fit_attachment as fit_attachment
    from jbw.measurement.spectra import frf as frf
    from jbw.measurement.transients import record_frf as record_frf
    from jbw.oscillator import conventions as conventions
    from jbw.oscillator import excitation as excitation
    from jbw.oscillator import laws as laws
    from jbw.oscillator.attachment import Attachment as Attachment
    from jbw.oscillator.attachment import attached as attached
    from jbw.oscillator.dimensionless import dimensionless as dimensionless
    from jbw.oscillator.laws.hysteresis import hysteresis_map as hysteresis_map
    from jbw.oscillator.laws.hysteresis import hysteresis_rate as hysteresis_rate
    from jbw.oscillator.laws.hysteresis import steady_loop as steady_loop
    from jbw.oscillator.laws.springs import Cubic as Cubic
    from jbw.oscillator.laws.springs import Polynomial as Polynomial
    from jbw.oscillator.modes.parameters import structure_of as structure_of
    from jbw.oscillator.modes.structure import Structure as Structure
    from jbw.oscillator.modes.structure import internal_resonances as internal_resonances
    from jbw.oscillator.oscillator import BoucWen as BoucWen
    from jbw.oscillator.oscillator import Oscillator as Oscillator
    from jbw.oscillator.periodic import shooting as shooting
    from jbw.oscillator.response import Response as Response
    from jbw.oscillator.response import simulate as simulate
    from jbw.oscillator.steady.backbone import backbone as backbone
    from jbw.oscillator.steady.backbone import frequency_response as frequency_response
    from jbw.oscillator.steady.continuation import response_curve as response_curve
    from jbw.oscillator.steady.cycle import steady_cycle as steady_cycle
    from jbw.oscillator.steady.cycle import steady_state as steady_state
    from jbw.paper.coefficients import smoothing as smoothing
    from jbw.paper.kernels import h1 as h1
    from jbw.paper.kernels import h3 as h3
    from jbw.paper.kernels import third_harmonic as third_harmonic
    from jbw.planning.making import plan_tests as plan_tests
    from jbw.population.basis import new_prediction as new_prediction
    from jbw.population.fleet import fleet_of as fleet_of
    from jbw.population.fleet import read_fleet as read_fleet
    from jbw.population.fleet import write_fleet as write_fleet
    from jbw.population.one_stage import one_stage as one_stage
    from jbw.population.population import population_of as population_of
    from jbw.population.prediction import new_backbone as new_backbone
    from jbw.population.prediction import new_units as new_units
    from jbw.report import plots as plots
    from jbw.report.modal_backbones import draw_backbones as draw_backbones
    from jbw.study.identifiability import identifiability as identifiability
    from jbw.study.identify import identify as identify
    from jbw.study.many import identify_many as identify_many
    from jbw.study.numpyro_model import numpyro_model as numpyro_model
    from jbw.study.study import Study as Study
    from jbw.study.study import load_study as load_study
    from jbw.verification.predict import warnings_of as warnings_of
    from jbw.watch.sequential import updated as updated

__version__ = "0.1.0"

# Home module of each public name, read only when the name is first used.
_HOME = {
    "Attachment": "oscillator.attachment",
    "BoucWen": "oscillator.oscillator",
    "Campaign": "campaign.load",
    "ConfigError": "errors",
    "Cubic": "oscillator.laws.springs",
    "DataError": "errors",
    "JbwError": "errors",
    "Joint": "assembly.joint",
    "MatrixModel": "assembly.matrices",
    "ModelError": "errors",
    "Oscillator": "oscillator.oscillator",
    "Polynomial": "oscillator.laws.springs",
    "Record": "measurement.records",
    "RandomProfile": "forced.profiles",
    "Pulse": "forced.shock",
    "ReducedModel": "assembly.reduce",
    "Response": "oscillator.response",
    "RunError": "errors",
    "Structure": "oscillator.modes.structure",
    "Study": "study.study",
    "Test": "measurement.records",
    "attached": "oscillator.attachment",
    "backbone": "oscillator.steady.backbone",
    "compare": "lab.samplers",
    "compare_laws": "law_comparison.compare",
    "dimensionless": "oscillator.dimensionless",
    "draw_backbones": "report.modal_backbones",
    "energy_shares": "assembly.separability",
    "fleet_of": "population.fleet",
    "fit_attachment": "measurement.shaker",
    "fit_modes": "identification.modal",
    "frequency_response": "oscillator.steady.backbone",
    "frf": "measurement.spectra",
    "from_sep005": "measurement.files.sep005",
    "h1": "paper.kernels",
    "h3": "paper.kernels",
    "harmonics": "measurement.harmonics",
    "hysteresis_map": "oscillator.laws.hysteresis",
    "hysteresis_rate": "oscillator.laws.hysteresis",
    "identifiability": "study.identifiability",
    "identify": "study.identify",
    "identify_many": "study.many",
    "internal_resonances": "oscillator.modes.structure",
    "joint_separability": "assembly.separability",
    "joint_starts": "assembly.starts",
    "line_fit": "identification.linear",
    "load_campaign": "campaign.load",
    "load_study": "study.study",
    "matrix_model": "assembly.matrices",
    "new_backbone": "population.prediction",
    "new_prediction": "population.basis",
    "new_units": "population.prediction",
    "one_stage": "population.one_stage",
    "numpyro_model": "study.numpyro_model",
    "plan_tests": "planning.making",
    "pool": "identification.linear",
    "profile_of": "forced.profiles",
    "population_of": "population.population",
    "read": "measurement.files.read",
    "read_fleet": "population.fleet",
    "read_profile": "forced.profiles",
    "read_matrices": "assembly.files.read",
    "record_frf": "measurement.transients",
    "reduce": "assembly.reduce",
    "response_curve": "oscillator.steady.continuation",
    "sbc": "lab.calibration",
    "shock_spectrum": "forced.shock",
    "shooting": "oscillator.periodic",
    "simulate": "oscillator.response",
    "smoothing": "paper.coefficients",
    "steady_cycle": "oscillator.steady.cycle",
    "steady_loop": "oscillator.laws.hysteresis",
    "steady_state": "oscillator.steady.cycle",
    "structure_of": "oscillator.modes.parameters",
    "third_harmonic": "paper.kernels",
    "third_order_kernel": "measurement.probing",
    "to_sep005": "measurement.files.sep005",
    "updated": "watch.sequential",
    "warnings_of": "verification.predict",
    "write_fleet": "population.fleet",
    "write_uff": "measurement.files.uff",
}

# Packages and modules that are public as a whole.
_ROOMS = {
    "conventions": "jbw.oscillator.conventions",
    "excitation": "jbw.oscillator.excitation",
    "forced": "jbw.forced",
    "plots": "jbw.report.plots",
    "laws": "jbw.oscillator.laws",
    "paper": "jbw.paper",
    "rig": "jbw.rig",
    "sampling": "jbw.inference.sampling",
    "steps": "jbw.identification.paper.steps",
}

__all__ = [*_HOME, *_ROOMS, "citation", "enable_x64"]  # pyright: ignore[reportUnsupportedDunderAll]


def enable_x64() -> None:
    """Switch JAX to float64 for this process; jbw never does so on its own.

    Examples:
        >>> import jbw
        >>> import jax.numpy as jnp
        >>> jbw.enable_x64()
        >>> print(jnp.ones(1).dtype)
        float64
    """
    import jax

    jax.config.update("jax_enable_x64", True)


def citation() -> str:
    """Return the citation of this version of jbw and of the paper whose method it implements.

    Returns:
        The text of `CITATION.cff`, in the Citation File Format, which Zenodo, Zotero and most
        software forges read.

    Examples:
        The second line is the title:

        >>> import jbw
        >>> print(jbw.citation().splitlines()[1])
        title: "jbw: Bayesian identification of bolted joints from vibration measurements"
    """
    from pathlib import Path

    package = Path(__file__).parent
    # The wheel contains the file in the package; in a clone the file is next to the package.
    packed = package / "CITATION.cff"
    file = packed if packed.is_file() else package.parent / "CITATION.cff"
    return file.read_text(encoding="utf-8")


def __getattr__(name: str) -> Any:
    if name in _ROOMS:
        return import_module(_ROOMS[name])
    if name in _HOME:
        return getattr(import_module(f"jbw.{_HOME[name]}"), name)
    raise AttributeError(f"module 'jbw' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({"__all__", "__doc__", "__version__", *__all__})
