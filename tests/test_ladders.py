"""How often code outside their rooms names laws, kinds of data and samplers.

A law, a kind of test or a sampler should be one file and one registration; every other place that
knows one by name is a rung of a ladder that the next one must climb. `LIMITS` is where the code
stands and may only go down, towards `GOALS`. Lines and files are counted in the table by room and
have no limit here: a limit on lines once took the paper's mathematics out of the package.

    python tests/test_ladders.py
"""

import ast
import re
import sys
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1] / "jbw"
# What may say Bouc-Wen: the oscillator, and the steps that are the paper's alone.
# (`inference` names none of the joint's parameters: its gammas are functions and distributions.)
PAPER = ("oscillator/", "inference/", "paper/", "identification/paper/")
# Pages of `jbw explain` name parameters as examples; code beside them is counted as elsewhere.
PROSE = "report/messages/"
PAPER_TODAY = ("identification/third_order.py", "identification/cut.py")  # as it was in 0.1
WORDS = {"alpha", "delta", "gamma", "alpha_delta", "alpha_gamma", "BoucWen", "joint_of"}
PRODUCTS = {"softening", "opening", "share"}  # words of English too: counted as whole strings
IN_PROSE = re.compile(rf"\b({'|'.join(sorted(WORDS))})\b")
SAMPLERS = {
    "nuts",
    "elliptical_slice",
    "random_walk",
    "random_walk_paper",
    "importance",
    "amis",
    "tempered_smc",
    "nested",
    "quadrature",
}
KINDS = {"noise", "multisine", "tones", "stepped", "sweep", "decay", "frf", "loop"}
GOALS = {"law": 40, "isinstance": 3, "kind": 15, "samplers": 1}
LIMITS = {"law": 32, "isinstance": 3, "kind": 10, "samplers": 1}


def docstrings(tree):
    """The nodes that are docstrings, of modules, classes, functions and attributes alike."""
    return {
        id(node.value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    }


def spoken(tree):
    """Every identifier of the code, and every string that is no docstring.

    A keyword `alpha=` beside another of matplotlib's is a transparency, and no parameter.
    """
    told = docstrings(tree)
    for node in ast.walk(tree):
        match node:
            case ast.Name(id=name) | ast.Attribute(attr=name) | ast.arg(arg=name):
                yield name, False
            case ast.alias(name=name) | ast.FunctionDef(name=name) | ast.ClassDef(name=name):
                yield name.rpartition(".")[2], False
            case ast.Call(keywords=keywords):
                styled = {one.arg for one in keywords} & {"color", "lw", "linewidth", "zorder"}
                for one in keywords:
                    plotted = one.arg == "alpha" and (styled or isinstance(one.value, ast.Constant))
                    if one.arg and not plotted:
                        yield one.arg, False
            case ast.Constant(value=str(text)) if id(node) not in told:
                yield text, True


def law_words(tree, *, prose=False):
    """How often a parameter of the law, a product or its record is named; not in `prose`."""
    count = 0
    for text, is_string in spoken(tree):
        if prose and is_string:
            continue
        if text in WORDS or (text in PRODUCTS and is_string):
            count += 1
        elif is_string:
            count += len(IN_PROSE.findall(text))
    return count


def data_kinds():
    """Names of the records of data: the classes of the room `observables`."""
    trees = (ast.parse(path.read_text(encoding="utf-8")) for path in ROOT.glob("observables/*.py"))
    return {node.name for tree in trees for node in tree.body if isinstance(node, ast.ClassDef)}


def isinstances(tree, kinds):
    """Calls of isinstance, and cases of a match, on kinds of data; h5py has a `Group` as well."""
    found = 0
    for node in ast.walk(tree):
        match node:
            case ast.Call(func=ast.Name(id="isinstance"), args=[_, asked]):
                parts = list(ast.walk(asked))
                named = {part.id for part in parts if isinstance(part, ast.Name)}
                if "h5py" not in named:
                    named |= {part.attr for part in parts if isinstance(part, ast.Attribute)}
                found += bool(named & kinds)
            case ast.MatchClass(cls=ast.Name(id=name) | ast.Attribute(attr=name)):
                found += name in kinds
    return found


def kind_tests(tree):
    """Comparisons, look-ups and matches on `.kind`, and of a local name with a kind of test."""
    found = 0
    for node in ast.walk(tree):
        match node:
            case ast.Compare(left=left, comparators=others):
                asked = [left, *others]
            case ast.Match(subject=subject):
                asked = [subject]
            case ast.Subscript(slice=index):
                asked = [index]
            case _:
                continue
        texts = {part.value for part in ast.walk(node) if isinstance(part, ast.Constant)}
        local = any(isinstance(one, ast.Name) and one.id == "kind" for one in asked)
        found += any(map(is_kind, asked)) or bool(local and texts & KINDS)
    return found


def is_kind(node):
    """Whether a node is the `.kind` of something other than a dtype."""
    if not isinstance(node, ast.Attribute) or node.attr != "kind":
        return False
    return not (isinstance(node.value, ast.Attribute) and node.value.attr == "dtype")


def sampler_lists(tree):
    """Collections that name two samplers or more."""
    found = 0
    for node in ast.walk(tree):
        match node:
            case ast.List(elts=elements) | ast.Tuple(elts=elements) | ast.Set(elts=elements):
                parts = elements
            case ast.Dict(keys=keys):
                parts = keys
            case _:
                continue
        named = {one.value for one in parts if isinstance(one, ast.Constant)} & SAMPLERS
        found += len(named) > 1
    return found


def counted():
    """Room to its counts."""
    rooms, kinds = {}, data_kinds()
    for path in sorted(ROOT.rglob("*.py")):
        place = path.relative_to(ROOT).as_posix()
        source = path.read_text(encoding="utf-8")
        tree = ast.parse(source)
        paper = place.startswith(PAPER) or place in PAPER_TODAY
        room = place.split("/")[0] if "/" in place else "(root)"
        rooms.setdefault(room, Counter()).update(
            law=0 if paper else law_words(tree, prose=place.startswith(PROSE)),
            isinstance=isinstances(tree, kinds),
            kind=kind_tests(tree),
            samplers=sampler_lists(tree),
            lines=len(source.splitlines()),
            files=1,
        )
    return rooms


@pytest.fixture(scope="module")
def total():
    return sum(counted().values(), Counter())


@pytest.mark.parametrize("name", GOALS)
def test_a_ladder_gets_no_longer(name, total):
    assert total[name] <= max(LIMITS[name], GOALS[name])


def test_the_counting_sees_code_and_not_prose():
    tree = ast.parse(
        '"""alpha."""\n'
        "from jbw.oscillator import BoucWen\n"  # 1
        "def f(alpha, share):\n"  # 1: `share` is an English word, unless it is a string
        '    """gamma."""\n'
        "    # delta\n"
        "    axes.plot(x, alpha=0.3, color=c)\n"
        "    axes.fill(x, alpha=0.3)\n"
        "    g(alpha=found)\n"  # 1
        '    return theta["share"], f"{x} of gamma and delta"\n'  # 1 + 2
    )
    assert law_words(tree) == 6
    assert kind_tests(ast.parse("a.kind == 'x' or a.kind in b or c[a.kind] or f(a.kind)")) == 3
    assert sampler_lists(ast.parse("A = ('nuts', 'nested'); B = ('nuts', 'x')")) == 1
    assert (
        isinstances(ast.parse("isinstance(a, b.Loops | int), isinstance(a, int)"), {"Loops"}) == 1
    )


if __name__ == "__main__":
    if len(sys.argv) > 1:
        ROOT = Path(sys.argv[1])
    rooms = counted()
    total = sum(rooms.values(), Counter())
    columns = (*GOALS, "lines", "files")
    print(f"{'room':<16}" + "".join(f"{name:>12}" for name in columns))
    for room, row in {**rooms, "total": total, "limit": LIMITS, "goal": GOALS}.items():
        print(f"{room:<16}" + "".join(f"{row.get(name, 0):>12,}" for name in columns))
