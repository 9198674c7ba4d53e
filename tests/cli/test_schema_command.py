"""`jbw schema`: what editors are told of the files agrees with what jbw takes."""

import json
import tomllib
from pathlib import Path

import jsonschema
import pytest

import jbw
from jbw.campaign.schema import read_spec
from jbw.campaign.settings import Identify
from jbw.campaign.tables import TestSpec
from jbw.cli import run
from jbw.measurement.kinds import KINDS
from jbw.planning import EXAMPLE

CAMPAIGNS = sorted((Path(jbw.__file__).parents[1] / "notebooks" / "campaigns").glob("*.toml"))


@pytest.fixture(scope="module")
def schemas():
    from click.testing import CliRunner

    from jbw.cli.about import schema

    schema_by_file = {
        name: json.loads(CliRunner().invoke(schema, [name]).stdout) for name in ("campaign", "plan")
    }
    for document in schema_by_file.values():
        jsonschema.Draft202012Validator.check_schema(document)
    return {
        name: jsonschema.Draft202012Validator(document) for name, document in schema_by_file.items()
    }


def test_it_is_the_campaign_file_by_default_and_knows_two_files(capsys):
    assert run(["schema", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["properties"].keys() == {
        "campaign", "assembly", "joint", "structure", "test", "identify",
    }  # fmt: skip
    assert run(["schema", "plam"]) == 2


@pytest.mark.parametrize("path", CAMPAIGNS, ids=lambda path: path.stem)
def test_campaign_files_that_jbw_takes_are_valid(schemas, path):
    assert read_spec(path).tests
    schemas["campaign"].validate(tomllib.loads(path.read_text()))


def test_the_example_of_a_plan_is_valid(schemas):
    schemas["plan"].validate(tomllib.loads(EXAMPLE))
    assert not schemas["plan"].is_valid({"plan": {"dleta": 3.0}})


TEST = {"kind": "sweep", "files": "a.h5", "channels": {"input": "u", "velocity": "v"}}


@pytest.mark.parametrize(
    "change",
    [
        {"test": [{**TEST, "kind": "sweeep"}]},
        {"test": [{**TEST, "levle": 0.2}]},
        {"test": [{**TEST, "channels": {"velocty": "v"}}]},
        {"test": [{**TEST, "periods": 0}]},
        {"test": [{"kind": "sweep"}]},
        {"test": []},
        {"identify": {"num_chains": 0}},
        {"identify": {"sampler": "nust"}},
        {"identify": {"prior": {"zeta": [0.1]}}},
        {"campaign": {"gain": -1.0}},
        {"identfy": {}},
    ],
)
def test_what_jbw_refuses_is_marked(schemas, change):
    schemas["campaign"].validate({"test": [TEST]})
    assert not schemas["campaign"].is_valid({"test": [TEST], **change})


def test_every_key_says_what_it_means(schemas):
    tables = schemas["campaign"].schema["$defs"]
    for table, model in (("TestSpec", TestSpec), ("Identify", Identify)):
        assert set(tables[table]["properties"]) == set(model.model_fields)
        assert all(key["description"] for key in tables[table]["properties"].values())
    assert tables["TestSpec"]["properties"]["kind"]["enum"] == list(KINDS)
