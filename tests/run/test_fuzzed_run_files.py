"""Any damage to what a run keeps: it is noticed, and no damaged number is ever gone on with."""

import hashlib
import json
import warnings
from contextlib import suppress
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from jbw.errors import JbwError, RunError
from jbw.parts import KeptParts
from jbw.run.checkpoints import Checkpoint, Interruption, pack
from jbw.run.folder import HIDDEN, begin, reopen, require_same
from jbw.run.manifest import Manifest

ARRAYS = {"state/0": np.arange(5, dtype=np.uint32), "theta/gamma": np.full((2, 5), 1 / 3)}
CHANGES = st.one_of(
    st.tuples(st.just("cut"), st.integers(0)),
    st.tuples(st.just("flip"), st.integers(0)),
    st.tuples(st.just("junk"), st.binary(max_size=200)),
)
FUZZED = settings(max_examples=50, deadline=5000, suppress_health_check=list(HealthCheck))


def changed(data, change):
    how, what = change
    if how == "junk":
        return what
    place = what % len(data)
    flipped = data[:place] + bytes([data[place] ^ 1 << what % 8]) + data[place + 1 :]
    return data[:place] if how == "cut" else flipped


@pytest.mark.fault(44)
@FUZZED
@given(first=CHANGES, second=st.none() | CHANGES)
def test_a_damaged_checkpoint_is_never_used(tmp_path_factory, first, second):
    folder = tmp_path_factory.mktemp("run")
    newer, older = (pack(number, ARRAYS) for number in (7, 6))
    (folder / "joint.0.checkpoint").write_bytes(changed(newer, first))
    (folder / "joint.1.checkpoint").write_bytes(older if second is None else changed(older, second))
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        arrays = Checkpoint(folder, "joint", Interruption()).load()
    assert "damaged" in str(warned[0].message)
    if second is not None:
        assert arrays is None
        return
    assert arrays is not None
    for name, values in ARRAYS.items():
        np.testing.assert_array_equal(arrays[name], values)


@pytest.mark.fault(43, 44)
@FUZZED
@given(change=CHANGES)
@example(change=("junk", b"[" * 100_000))
@example(change=("junk", b'{"sha256": {}}'))
def test_a_damaged_manifest_is_refused(tmp_path_factory, change):
    folder = tmp_path_factory.mktemp("run")
    begin(folder, Manifest("jbw identify beam.toml", "/data/beam.toml", seed=3)).close()
    path = folder / HIDDEN / "manifest.json"
    path.write_bytes(changed(path.read_bytes(), change))
    with pytest.raises(RunError) as caught:
        reopen(folder)
    assert "manifest.json is damaged" in caught.value.what
    assert "another folder" in caught.value.remedy


JSON = st.recursive(
    st.none() | st.booleans() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner),
    max_leaves=6,
)


PLACES = st.sampled_from(["../../x", "/x", "~", "", ".", "a\0b", "campaign/campaign.toml"])


@pytest.mark.fault(43, 53)
@settings(FUZZED, max_examples=30)
@given(
    changes=st.dictionaries(
        st.sampled_from([field.name for field in fields(Manifest)]) | st.text(max_size=5),
        JSON | PLACES | st.dictionaries(PLACES, JSON | PLACES, max_size=2),
        min_size=1, max_size=4,
    )
)  # fmt: skip
@example(changes={"preset": "paper", "campaign": "../../x"})
@example(changes={"inputs": {"../../x": "0"}})
@example(changes={"inputs": {"a\0b": "0"}})
@example(changes={"text": "x", "campaign": "a\0b"})
def test_any_manifest_with_a_hash_of_its_own_is_taken_or_refused(tmp_path_factory, changes):
    """Whoever makes a manifest can seal it: its fields are taken, or refused by name."""
    outer = tmp_path_factory.mktemp("outer")
    folder = outer / "runs" / "run"
    begin(folder, Manifest("jbw identify beam.toml", str(outer / "beam.toml"))).close()
    path = folder / HIDDEN / "manifest.json"
    content = {**json.loads(path.read_text()), **changes}
    content.pop("sha256")
    digest = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
    path.write_text(json.dumps({**content, "sha256": digest}))
    with suppress(JbwError):
        run = reopen(folder)
        assert run is not None
        try:
            require_same(run)
            assert isinstance(run.to_resume, str)
            assert isinstance(run.campaign, Path)
        finally:
            run.close()
    assert {inside.name for inside in outer.iterdir()} == {"runs"}
    assert {inside.name for inside in folder.iterdir()} == {HIDDEN}


VALUE = {"name": "law", "scores": [1.5, None, (True, "x")], "draws": np.arange(6.0).reshape(2, 3)}


@pytest.mark.fault(44)
@FUZZED
@given(change=CHANGES)
def test_a_damaged_part_of_a_job_is_made_again(tmp_path_factory, change):
    parts, made = KeptParts(tmp_path_factory.mktemp("job"), "mark"), []

    def make():
        made.append(True)
        return VALUE

    parts("a part", make)
    (path,) = parts.folder.iterdir()
    whole = path.read_bytes()
    path.write_bytes(changed(whole, change))
    again = parts("a part", make)
    assert len(made) == 2
    assert path.read_bytes() == whole
    np.testing.assert_array_equal(again.pop("draws"), VALUE["draws"])
    assert again == {name: value for name, value in VALUE.items() if name != "draws"}


@pytest.mark.fault(45)
@FUZZED
@given(content=st.binary(max_size=60) | JSON.map(lambda value: json.dumps(value).encode()))
def test_any_stale_lock_is_taken_over(tmp_path_factory, content):
    folder = tmp_path_factory.mktemp("run")
    begin(folder, Manifest("jbw identify beam.toml", "/data/beam.toml")).close()
    (folder / HIDDEN / "lock").write_bytes(content)
    run = reopen(folder)
    assert run is not None
    run.close()
