"""Whatever lies in the arrays of a file: a check finds it or refuses it, and never breaks."""

import json
import warnings

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from jbw.campaign.check import as_json, check_campaign
from jbw.errors import ConfigError

UNITS = {
    "input": "V",
    "force": "N",
    "velocity": "m/s",
    "displacement": "m",
    "acceleration": "m/s^2",
    "restoring_force": "N",
    "frequency": "Hz",
    "phase": "rad",
    "time": "s",
}
# What each kind needs at least; more may be drawn beside.
NEEDED = {
    "noise": ["input", "velocity"],
    "multisine": ["force", "displacement"],
    "tones": ["input", "acceleration"],
    "stepped": ["input", "velocity"],
    "sweep": ["force", "acceleration"],
    "decay": ["velocity"],
    "frf": ["frequency", "force", "acceleration", "phase"],
    "loop": ["displacement", "restoring_force"],
}
SAMPLES = {
    "noise": lambda rng, n: rng.normal(size=n),
    "zeros": lambda rng, n: np.zeros(n),
    "ramp": lambda rng, n: np.arange(n) * 0.01,
    "all NaN": lambda rng, n: np.full(n, np.nan),
    "some NaN": lambda rng, n: np.where(rng.random(n) < 0.1, np.nan, rng.normal(size=n)),
    "few integers": lambda rng, n: rng.integers(0, 3, n),
    "complex": lambda rng, n: rng.normal(size=n) + 1j,
    "huge": lambda rng, n: rng.normal(size=n) * 1e300,
    "two rows": lambda rng, n: rng.normal(size=(2, n)),
    "late": lambda rng, n: np.arange(n) >= n // 2,
}
LENGTHS = st.sampled_from([0, 1, 2, 3, 7, 50, 400])


@st.composite
def tables(draw):
    """A [[test]] table that is valid by its keys, and what its arrays hold."""
    kind = draw(st.sampled_from(sorted(NEEDED)))
    more = (
        [] if kind == "frf" else draw(st.lists(st.sampled_from(["time", "velocity"]), max_size=1))
    )
    roles = list(dict.fromkeys([*NEEDED[kind], *more]))
    n = draw(LENGTHS)
    arrays = {
        role: (draw(st.sampled_from(sorted(SAMPLES))) if draw(st.booleans()) else "noise",
               draw(LENGTHS) if draw(st.integers(0, 9)) == 0 else n)
        for role in roles
    }  # fmt: skip
    keys = {"kind": f'"{kind}"', "files": '"a.npz"'}
    if "time" not in roles and kind != "frf":
        keys["fs"] = "100.0"
    keys |= {"tones": "[2.0, 5.0]"} if kind in ("tones", "stepped") else {}
    keys |= {"dwell": "1.5"} if kind == "stepped" else {}
    keys |= {"gaps": '"mask"'} if kind == "frf" and draw(st.booleans()) else {}
    keys |= {"remove_mean": "true"} if kind != "frf" and draw(st.booleans()) else {}
    free = {"band": "[1.0, 20.0]", "settle": "0.5", "periods": "2", "repeats": '"rows"'}
    keys |= {key: value for key, value in free.items() if draw(st.booleans())}
    return keys, arrays


@settings(max_examples=250, deadline=None, suppress_health_check=list(HealthCheck))
@given(table=tables(), seed=st.integers(0, 9))
def test_any_record_is_checked_without_breaking(tmp_path_factory, table, seed):
    keys, arrays = table
    folder, rng = tmp_path_factory.mktemp("any"), np.random.default_rng(seed)
    np.savez(folder / "a.npz", **{r: SAMPLES[what](rng, n) for r, (what, n) in arrays.items()})
    channels = ", ".join(f'{role} = "{role}"' for role in arrays)
    units = ", ".join(f'{role} = "{UNITS[role]}"' for role in arrays)
    lines = [f"channels = {{ {channels} }}", f"units = {{ {units} }}"]
    lines += [f"{key} = {value}" for key, value in keys.items()]
    head = ["[campaign]", "gain = 1.0", "[[test]]"]
    (folder / "campaign.toml").write_text("\n".join([*head, *lines]))
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # a numerical warning is a number that nobody checked
        try:
            found = check_campaign(folder / "campaign.toml")
        except ConfigError:
            return
    # 3 for what a record is, 2 for what the campaign does not state of it.
    assert (found.exit_code in (2, 3)) == (found.status == "error")
    json.dumps(as_json(found), allow_nan=False)
