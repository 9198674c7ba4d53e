"""The house: who may import whom, read from the syntax trees, and what an import may do."""

import ast
import subprocess
import sys
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import jbw

ROOT = Path(jbw.__file__).parent
FILES = sorted(ROOT.rglob("*.py"))
ANYWHERE = {
    "cache",
    "errors",
    "memory",
    "parts",
    "quantities",
    "results",
    "sources",
    "units",
    "messages",
}
LEAVES = {"oscillator", "measurement", "inference"}
MODEL = LEAVES | {"campaign", "observables"}
# Every room, to the rooms that it may see beside itself and those that may be seen from anywhere.
# Lowest first: no room sees one that stands below it in this table.
SEES = {
    "cache": set(),
    "errors": set(),
    "memory": set(),
    "sources": set(),
    "units": set(),
    "quantities": set(),
    "results": set(),
    "messages": set(),  # the catalogue, report/messages: seen from anywhere, sees no room
    "run": set(),
    "parts": {"run"},
    "kept_programs": set(),  # compiled functions, which the leaves and `observables` keep
    "oscillator": {"kept_programs"},
    "forced": {"oscillator"},  # what a known joint does under other loads
    "measurement": set(),
    "assembly": {"measurement", "oscillator"},
    "inference": {"kept_programs"},
    "paper": {"inference", "oscillator"},
    "freeform": {"measurement"},
    "campaign": {"assembly", "inference", "measurement", "oscillator"},
    "rig": {"assembly", "campaign", "measurement", "oscillator"},
    "report": {"inference", "measurement", "oscillator", "run"},
    "observables": LEAVES | {"kept_programs"},
    "identification": MODEL | {"paper"},
    "verification": MODEL | {"identification"},
    "planning": MODEL | {"verification"},
    "study": MODEL
    | {"assembly", "forced", "freeform", "identification", "verification"}
    | {"report", "rig", "run"},
    "export": {"assembly", "oscillator", "report", "study", "verification"},
    "law_comparison": MODEL | {"identification", "report", "run", "study", "verification"},
    "lab": MODEL | {"identification", "report", "rig", "run", "study"},
    "population": MODEL | {"verification", "report", "run", "study"},
    "watch": MODEL - {"oscillator"}
    | {"identification", "population", "run", "study", "verification"},
    "cli": MODEL
    | {"forced", "report", "rig", "run", "study", "verification"}
    | {"export", "lab", "law_comparison", "planning", "population", "watch"},
}
# What stands on an identification and is no part of it: a command each, and no other room but one
# of them and the command line sees it.
EXTENSIONS = {"export", "lab", "law_comparison", "planning", "population", "watch"}
# Rooms within a room: what each may see of its siblings.
WITHIN = {
    "inference": {
        "space": set(),
        "fit": {"space"},
        "groups": set(),
        "posterior": {"fit", "space"},
        "samplers": {"posterior", "space"},
        "calibration": {"fit", "posterior", "samplers", "space"},
    },
}


@cache
def parsed(path):
    return ast.parse(path.read_text(encoding="utf-8"))


def name_of(path):
    return str(path.relative_to(ROOT))


def told(wrong):
    """The files where something is wrong."""
    return {name: found for name, found in wrong.items() if found}


def room(path):
    return room_named(path.relative_to(ROOT).with_suffix("").as_posix().replace("/", "."))


def room_named(module):
    """The room of a module, named below `jbw`; the catalogue is one within `report`."""
    return "messages" if f"{module}.".startswith("report.messages.") else module.split(".")[0]


@cache
def imports(path):
    """Modules that a file imports, and whether the import stands inside a function."""
    tree = parsed(path)
    inside = {
        id(node)
        for function in ast.walk(tree)
        if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef)
        for node in ast.walk(function)
    }
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found += [(alias.name, id(node) in inside) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            found.append((node.module or "", id(node) in inside))
            if (node.module or "").split(".")[0] == "jbw":
                found += [(f"{node.module}.{a.name}", id(node) in inside) for a in node.names]
    return tuple(found)


def seen(path):
    """Rooms that a file imports from, in functions too."""
    named = [name.removeprefix("jbw.") for name, _ in imports(path) if name.startswith("jbw.")]
    # `from jbw.report.messages import x` names `report.messages` and its file, not `report`.
    rooms = {room_named(name) for name in named}
    return {name for name in rooms if name in SEES}


FRONT_DOORS = {"__init__", "__main__"}  # public names that lie everywhere, and the command


def test_every_room_is_named():
    rooms = {room(path) for path in FILES} - FRONT_DOORS
    assert rooms == SEES.keys()


def test_no_room_sees_one_above_it():
    order = list(SEES)
    for name, allowed in SEES.items():
        above = order[order.index(name) :]
        assert not allowed & set(above), name


def test_a_room_sees_only_the_rooms_below_it():
    wrong = {}
    for path in FILES:
        if room(path) not in FRONT_DOORS:
            wrong[name_of(path)] = seen(path) - ANYWHERE - {room(path)} - SEES[room(path)]
    assert not told(wrong)


def test_the_core_sees_no_extension():
    core = SEES.keys() - EXTENSIONS - {"cli"}
    assert not {name: SEES[name] & EXTENSIONS for name in core if SEES[name] & EXTENSIONS}


def test_a_room_within_a_room_sees_only_its_siblings_below():
    wrong = {}
    for path in FILES:
        whole, *rest = path.relative_to(ROOT).parts
        if whole in WITHIN and len(rest) > 1 and rest[0] in WITHIN[whole]:
            names = [n.split(".") for n, _ in imports(path) if n.startswith(f"jbw.{whole}.")]
            siblings = {name[2] for name in names if name[2] in WITHIN[whole]}
            wrong[name_of(path)] = siblings - {rest[0]} - WITHIN[whole][rest[0]]
    assert not told(wrong)


def test_no_circle_between_files():
    """Imports inside functions count: they hide a circle and do not undo it."""
    files = {
        ".".join(("jbw", *path.relative_to(ROOT).with_suffix("").parts)).removesuffix(
            ".__init__"
        ): path
        for path in FILES
        if path != ROOT / "__init__.py"
    }
    graph = {
        name: {other for other, _ in imports(path) if other in files} - {name}
        for name, path in files.items()
    }
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))


def test_heavy_libraries_live_in_their_rooms():
    light = {"assembly", "measurement", "campaign", "run", *ANYWHERE, "__init__"}
    heavy = {"jax", "numpyro", "diffrax", "optimistix", "equinox", "arviz"}
    homes = {
        "numpyro": {"inference", "population"}, "matplotlib": {"report"},
        "diffrax": {"oscillator", "paper"},
    }  # fmt: skip
    wrong = {}
    for path in FILES:
        top = {name.split(".")[0] for name, inside in imports(path) if not inside}
        away = {library for library, home in homes.items() if room(path) not in home}
        wrong[name_of(path)] = top & (heavy | away if room(path) in light else away)
    assert not told(wrong)


# Files whose words stand beside the settings that they explain, as keys of a campaign or of a plan.
OF_SETTINGS = ("campaign/settings", "campaign/tables", "report/messages")
SAID_AT_ONCE = {"warn", "warning", "option", "argument", "command", "Field", "Quantity"}
MOST_SENTENCES = 77  # outside the catalogue; it may only fall


def sentences_of(tree):
    """Strings of five words or more, but for docstrings and what is raised or warned of."""
    skipped = set()
    for node in ast.walk(tree):
        called = ""
        if isinstance(node, ast.Call):
            called = getattr(node.func, "id", getattr(node.func, "attr", ""))
        is_docstring = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        is_refusal = isinstance(node, ast.Raise) or called.endswith("Error")
        if is_docstring or is_refusal or called in SAID_AT_ONCE:
            skipped |= set(ast.walk(node))
    strings = [node for node in ast.walk(tree) if isinstance(node, ast.Constant)]
    return [
        node.value
        for node in strings
        if isinstance(node.value, str) and node not in skipped and node.value.count(" ") >= 4
    ]


def test_sentences_stand_in_the_catalogue():
    held = {
        name_of(path): sentences_of(parsed(path))
        for path in FILES
        if not name_of(path).startswith(OF_SETTINGS)
    }
    assert sum(map(len, held.values())) <= MOST_SENTENCES, told(held)


PAGE = 45  # lines of the body of `identify`


def test_identify_stands_on_one_page():
    """Its body, the docstring aside: a line a stage, no loop, no `replace` of what was made."""
    (function,) = [
        node
        for node in parsed(ROOT / "study" / "identify.py").body
        if isinstance(node, ast.FunctionDef)
    ]
    body = function.body[1:]
    assert body[-1].end_lineno - body[0].lineno + 1 <= PAGE
    loops = ast.For | ast.While | ast.Try | ast.FunctionDef
    names = {node.id for node in ast.walk(function) if isinstance(node, ast.Name)}
    assert not [
        node for statement in body for node in ast.walk(statement) if isinstance(node, loops)
    ]
    assert "replace" not in names


def test_no_array_is_made_by_jax_at_import():
    """It would have the precision of that moment, and `enable_x64` may come later."""
    wrong = {}
    for path in FILES:
        made = {
            node.lineno
            for statement in parsed(path).body
            if isinstance(statement, ast.Assign | ast.AnnAssign) and statement.value
            for node in ast.walk(statement.value)
            if isinstance(node, ast.Call) and ast.unparse(node.func).startswith("jnp.")
        }
        wrong[name_of(path)] = made
    assert not told(wrong)


def test_no_pickle_eval_or_assert():
    wrong = {}
    for path in FILES:
        nodes = list(ast.walk(parsed(path)))
        calls = {
            node.func.id
            for node in nodes
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
        }
        asserts = {"assert" for node in nodes if isinstance(node, ast.Assert)}
        modules = {name for name, _ in imports(path)}
        wrong[name_of(path)] = (
            asserts | calls & {"eval", "exec"} | modules & {"pickle", "yaml", "dill", "cloudpickle"}
        )
    assert not told(wrong)


def fresh(code):
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120
    )
    return done.stdout + done.stderr


def test_importing_jbw_prints_nothing_and_loads_nothing_heavy():
    heavy = "{'jax', 'arviz', 'arviz_base', 'matplotlib', 'numpyro', 'scipy'}"
    assert fresh(f"import sys, jbw; print(sorted({heavy} & set(sys.modules)), end='')") == "[]"


def test_importing_jbw_does_not_load_the_papers_mathematics():
    code = "import sys, jbw; dir(jbw); print([n for n in sys.modules if n[:9] == 'jbw.paper'])"
    assert fresh(code).strip() == "[]"


def test_the_papers_module_is_loaded_without_its_files():
    code = "import sys, jbw.paper; print('jax' in sys.modules, end='')"
    assert fresh(code) == "False"


def test_the_catalogue_loads_nothing_heavy():
    heavy = {"jax", "arviz", "matplotlib", "numpy", "scipy", "xarray", "pydantic", "click"}
    files = sorted((ROOT / "report" / "messages").glob("*.py"))
    names = ", ".join(f"jbw.report.messages.{path.stem}" for path in files)
    assert fresh(f"import sys, {names}; print(sorted({heavy} & set(sys.modules)), end='')") == "[]"


def test_the_page_of_a_report_loads_no_jax():
    code = "import sys, jbw.report.page; print('jax' in sys.modules, end='')"
    assert fresh(code) == "False"


def test_importing_every_public_name_leaves_the_precision_alone():
    code = (
        "import jbw\nfor name in jbw.__all__: getattr(jbw, name)\n"
        "import jax; print(jax.config.jax_enable_x64, end='')"
    )
    assert fresh(code).strip().endswith("False")
