"""What MkDocs asks while the site is built: pages made of the code itself, so that none is a copy.

A line `<!-- make WORDS -->` of a page becomes what `MAKERS` makes of the words: the commands, the
campaign file's keys, the laws, the figures, or a file of the repository. LaTeX of docstrings
becomes MathML, which browsers draw without a script.
"""

import ast
import html
import json
import re
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import groupby
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
NOTEBOOKS = ROOT / "notebooks"
SHOWN = ROOT / "docs" / "laboratories" / "shown"
MARK = re.compile(r"^<!-- make (\w+)(?: (\S+))? -->$", re.MULTILINE)
PUBLIC = re.compile(r"^::: jbw\.((?:paper\.)?\w+)$", re.MULTILINE)
OUTPUT = re.compile(r"^```text\n(.*?)^```", re.MULTILINE | re.DOTALL)
COLUMNS, COLUMN_GAP = 96, "   "  # letters in a line of an output; what parts columns of a table
MATH = re.compile(r'<(div|span) class="arithmatex">\\[\[(](.*?)\\[\])]</\1>', re.DOTALL)
# Of the theme, and of no use here: sources of its scripts, and search in other languages.
UNUSED = ("assets/javascripts/lunr", "**/*.map", "assets/hooks.py", "assets/draw_result.py")


def on_files(files: Any, config: Any) -> Any:
    """The pages' files, and the pictures that the notebooks hold."""
    from base64 import b64decode

    from mkdocs.structure.files import File

    for path in sorted(NOTEBOOKS.glob("*.ipynb")):
        for number, data in enumerate(pictures_of(path)):
            place = f"notebooks/{picture_name(path.stem, number)}"
            files.append(File.generated(config, place, content=b64decode(data)))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """A page's text with what is made of the code in the place of the marks."""
    made = MARK.sub(lambda mark: MAKERS[mark[1]](*filter(None, mark.groups()[1:])), markdown)
    made = OUTPUT.sub(lambda block: f"```text\n{folded(block[1])}```", made)
    return PUBLIC.sub(lambda name: public(name[1]), made)


def folded(output: str) -> str:
    """What was printed with its sentences folded; a wide table stays whole, and can be moved."""
    lines = []
    for line in map(str.rstrip, output.splitlines()):
        is_table = COLUMN_GAP in line.lstrip()
        lines += (
            [line] if is_table else textwrap.wrap(line, COLUMNS, break_long_words=False) or [""]
        )
    return "".join(f"{line}\n" for line in lines)


def on_page_content(html: str, **_: Any) -> str:
    """A page with its formulas as MathML."""
    return MATH.sub(lambda found: formula(found[2], found[1] == "div"), html)


def on_post_build(config: Any, **_: Any) -> None:
    """The site without files that no page asks for."""
    import shutil

    for pattern in UNUSED:
        for path in Path(config.site_dir).glob(pattern):
            shutil.rmtree(path) if path.is_dir() else path.unlink()


def formula(latex: str, displayed: bool) -> str:
    """LaTeX as MathML; formulas that follow each other on lines of their own come as one."""
    from latex2mathml.converter import convert

    display = "block" if displayed else "inline"
    numbered = re.sub(r"\\tag\{([^}]*)\}", r"\\qquad\\text{(\1)}", html.unescape(latex))
    parts = re.split(r"\$\$\s*\$\$", numbered)
    return "".join(convert(part.strip(), display=display) for part in parts)


def public(name: str) -> str:
    """What mkdocstrings is asked for: a public name, at its home, with an anchor of its own."""
    import jbw
    from jbw import paper

    room, _, last = name.rpartition(".")
    home = f"paper.{paper._HOME[last]}" if room else jbw._HOME.get(name)
    whole = f"jbw.{home}.{last}" if home else jbw._ROOMS.get(name, f"jbw.{name}")
    shown = f"    options:\n      heading: jbw.{name}\n      toc_label: {last}"
    return f"[](){{ #jbw.{name} }}\n\n::: {whole}\n{shown}"


def included(path: str) -> str:
    """A file of the repository, whose links to pages of the site lead there."""
    text = (ROOT / path).read_text(encoding="utf-8")
    return re.sub(r"\]\(docs/", "](", text)


def findings() -> str:
    """Every finding: its check, why it matters and what to do."""
    from jbw.report.messages.findings import explanations

    return "\n\n".join(f"## {code}\n\n{page}" for code, page in explanations().items())


def explained_words() -> str:
    """Every word of the report and column of its tables, with its meaning."""
    from jbw.report.messages.words import WORDS

    rows = [f"| {cell(', '.join(names))} | {cell(meaning)} |" for names, meaning in WORDS.items()]
    return "\n".join(["| word or column | meaning |", "| --- | --- |", *rows])


def cell(text: str) -> str:
    """A text within a cell of a table, whose strokes and stars would be marks."""
    return re.sub(r"([|*])", r"\\\1", text)


def commands() -> str:
    """Every command of `jbw`: its help, how it is called, and its options."""
    import click

    from jbw.cli import COMMANDS, cli

    parts = []
    for name in COMMANDS:
        command = cli.get_command(click.Context(cli), name)
        assert command is not None
        context = click.Context(command, info_name=f"jbw {name}")
        usage = command.get_usage(context).removeprefix("Usage: ")
        rows = [param.get_help_record(context) for param in command.get_params(context)]
        parts += [
            f"## jbw {name}",
            textwrap.dedent(command.help or ""),
            f"```sh\n{' '.join(usage.split())}\n```",
            table(("option", "meaning"), ((code(r[0]), r[1]) for r in rows if r and r[1])),
        ]
    return "\n\n".join(parts)


def campaign_keys() -> str:
    """Every table and key of a campaign file, from its schema."""
    from jbw.campaign.document import json_schema
    from jbw.campaign.schema import CampaignFile

    schema = json_schema(CampaignFile)
    known = schema["$defs"]
    parts = []
    for name, (head, table_name) in {
        "campaign": ("[campaign]", "Head"),
        "assembly": ("[assembly]", "Assembly"),
        "joint": ("[joint]", "JointLaws"),
        "structure": ("[structure]", "Structured"),
        "matrices": ("[structure]", "AssembledStructure"),
        "joints": ("[[joint]]", "JointTable"),
        "test": ("[[test]]", "TestSpec"),
        "identify": ("[identify]", "Identify"),
    }.items():
        rows = key_rows(known[table_name], known)
        parts += [
            f"## `{head}` {{ #{name} }}",
            about_table(schema["properties"].get(name, {}), known[table_name]),
            table(("key", "value", "meaning", "default", "example"), rows),
        ]
    return "\n\n".join(parts)


def about_table(field: Mapping[str, Any], schema: Mapping[str, Any]) -> str:
    """A sentence on a table: of the file's key where it has one of its own, else of its type."""
    return field.get("description", schema.get("description", "")).capitalize().rstrip(".") + "."


def key_rows(schema: Mapping[str, Any], known: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    """A row for each key of a table: what it takes, means, is by default, and an example."""
    from jbw.campaign.document import toml

    for name, field in schema["properties"].items():
        default = field.get("default")
        needed = "**needed**" if name in schema.get("required", ()) else ""
        yield (
            code(name),
            kind_of(field, known),
            field.get("description", ""),
            needed or ("" if default is None or default == "" else code(toml(default))),
            code(toml(field["examples"][0])) if field.get("examples") else "",
        )


def kind_of(field: Mapping[str, Any], known: Mapping[str, Any], *, many: bool = False) -> str:
    """The values that a key takes, in words, from its JSON Schema; `many` of them in a list."""
    if "$ref" in field:
        return kind_of(known[field["$ref"].rsplit("/", 1)[1]], known, many=many)
    if "anyOf" in field:
        told = [kind_of(each, known) for each in field["anyOf"]]
        listed = [one for one in field["anyOf"] if one.get("items") in field["anyOf"]]
        if listed:  # one of something, or a list of the same
            told = [kind_of(listed[0]["items"], known), "a list of such"]
            told += [kind_of(e, known) for e in field["anyOf"] if e.get("type") == "object"]
        return " or ".join(dict.fromkeys(told))
    if "enum" in field:
        return ", ".join(code(f'"{each}"') for each in field["enum"])
    if "const" in field:
        return code(f'"{field["const"]}"')
    match field.get("type"):
        case "array":
            items = [kind_of(each, known) for each in field.get("prefixItems", ())]
            if items:
                return f"[{', '.join(items)}]"
            return f"list of {kind_of(field['items'], known, many=True)}"
        case "object":
            values = field.get("additionalProperties")
            told = kind_of(values, known) if isinstance(values, Mapping) else "value"
            return f"table, name = {told}"
        case "boolean":
            return "true or false"
        case kind:
            word = {"integer": "whole number"}.get(str(kind), str(kind or "value"))
            return f"{word}s" if many else word


def kinds() -> str:
    """The kinds of test."""
    from jbw.measurement.kinds import KINDS

    return table(("kind", "test"), ((code(k.name), k.meaning) for k in KINDS.values()))


def roles() -> str:
    """The roles of channels, and the units that each may be in."""
    from jbw.measurement.records import QUANTITIES
    from jbw.units import FACTORS

    def units(quantities: Iterable[str]) -> str:
        return ", ".join(code(unit) for each in quantities for unit in FACTORS[each])

    rows = ((code(r), " or ".join(found), units(found)) for r, found in QUANTITIES.items())
    return table(("role", "quantity", "units"), rows)


def laws() -> str:
    """The laws of the joint, with their parameters."""
    from jbw.oscillator.laws import FAMILIES, LAWS, law_named

    parts = []
    for name, law in LAWS.items():
        if name in FAMILIES:  # told by its member of two
            name, law = f"{name}_N", law_named(f"{name}_2")
        said = re.sub(r"\s+", " ", (law.__doc__ or "").split("\n\n")[0])
        rows = ((code(q.name), q.symbol, code(q.unit), q.meaning) for q in law.table)
        parts += [
            f"## `{name}`",
            said,
            table(("parameter", "symbol", "unit", "meaning"), rows),
        ]
    return "\n\n".join(parts)


def equations() -> str:
    """The paper's equations: who computes them, what was wrong, and who uses them."""
    from jbw.paper import equations

    used = in_the_pipeline()
    rows = []
    for number, group in groupby(equations(), key=lambda row: row.number):
        for i, row in enumerate(group):
            said = f"{row.status}: {row.note}" if row.note else row.status
            pipeline = ", ".join(code(name) for name in used.get(number, ())) if i == 0 else ""
            link = f"[{code(row.function)}](reference/{page_of(row.function)}#{row.function})"
            rows.append((f"({number})" if i == 0 else "", link, said, pipeline))
    return table(("equation", "function", "status", "in the identification"), rows)


def equation(span: str) -> str:
    """The functions of a few equations, as 7-9 or 40, and what was wrong in print."""
    from jbw.paper import equations

    first, _, last = span.partition("-")
    rows = [row for row in equations() if int(first) <= row.number <= int(last or first)]
    numbers: dict[tuple[str, str, str], list[str]] = {}
    for row in rows:
        numbers.setdefault(row[1:], []).append(f"({row.number})")
    cells = (
        (", ".join(which), f"[{code(name)}](../reference/{page_of(name)}#{name})", status, note)
        for (name, status, note), which in numbers.items()
    )
    return table(("equation", "function", "print", "note"), cells)


def page_of(name: str) -> str:
    """The page of the reference that holds a public name."""
    for page in sorted((ROOT / "docs" / "reference").glob("*.md")):
        if re.search(rf"^::: {re.escape(name)}$", page.read_text(encoding="utf-8"), re.MULTILINE):
            return page.name
    raise LookupError(f"No page of docs/reference holds {name}.")


def in_the_pipeline() -> dict[int, list[str]]:
    """Functions of Steps 2 to 4 and of the measurements, by the equations they refer to."""
    from jbw.paper.table import numbers

    used: dict[int, list[str]] = {}
    for folder in ("identification", "measurement", "observables", "inference", "study"):
        for path in sorted((ROOT / "jbw" / folder).rglob("*.py")):
            tree = ast.parse(path.read_text(encoding="utf-8"))
            module = ".".join(path.relative_to(ROOT / "jbw").with_suffix("").parts)
            for node in ast.walk(tree):
                if not isinstance(node, ast.FunctionDef | ast.ClassDef):
                    continue
                _, mark, section = (ast.get_docstring(node) or "").partition("Reference:\n")
                for number in dict.fromkeys(numbers(section) if mark else ()):
                    used.setdefault(number, []).append(f"{module}.{node.name}")
    return used


def figure(name: str) -> str:
    """A figure of the report: what it answers, and what to look for."""
    from jbw.report.figures import FIGURE_LIST

    (entry,) = [each for each in FIGURE_LIST if each.name == name]
    stored = f"figures/{name}.png"
    shown = f"![{entry.question}]({stored})" if (ROOT / "docs" / stored).is_file() else ""
    head = f"### {entry.question} {{ #{name} }}"
    return f"{head}\n\n`{entry.slug}`\n\n{shown}\n\n{entry.caption}"


def cells(path: Path) -> list[Any]:
    """The cells of a notebook with its outputs, or of its text where it was never run."""
    import jupytext

    if path.is_file():
        return json.loads(path.read_text(encoding="utf-8"))["cells"]
    return jupytext.read(path.with_suffix(".py")).cells


def pictures_of(path: Path) -> list[str]:
    """Every picture that a notebook shows, base64, in the order of its cells."""
    outputs = [output for cell in cells(path) for output in cell.get("outputs", ())]
    found = [output["data"] for output in outputs if "data" in output]
    return [data["image/png"] for data in found if "image/png" in data]


def picture_name(name: str, number: int) -> str:
    """Where a picture of a notebook lies beside its page."""
    return f"outputs/{name}_{number}.png"


def joined(text: str | list[str]) -> str:
    """A text of a notebook, which may be kept as its lines."""
    return text if isinstance(text, str) else "".join(text)


def notebook(name: str) -> str:
    """A notebook as it is kept, with what its cells showed."""
    parts = [f"This page is the notebook `notebooks/{name}.ipynb`; open it to change and run it."]
    number = 0
    for cell in cells(NOTEBOOKS / f"{name}.ipynb"):
        source = joined(cell["source"])
        if cell["cell_type"] != "code":
            parts.append(source)
            continue
        code = re.sub(r"^%.*\n", "", source, flags=re.MULTILINE)
        parts.append(f"```python\n{code}\n```" if code.strip() else "")
        for output in cell["outputs"]:
            data = output.get("data", {})
            if "image/png" in data:
                parts.append(f"![What the cell above shows]({picture_name(name, number)})")
                number += 1
            else:
                text = joined(output.get("text") or data.get("text/plain", ""))
                parts.append(f"```text\n{text.rstrip()}\n```")
    head, *rest = parts
    return "\n\n".join([rest[0], head, *rest[1:]])


def gallery() -> str:
    """Every notebook with a picture of it, its title and its question."""
    rows = []
    for path in sorted(NOTEBOOKS.glob("*.ipynb"), key=lambda p: int(p.stem.partition("_")[0])):
        text = joined(cells(path)[0]["source"])
        title = text.splitlines()[0].removeprefix("# ")
        asked = re.search(r"\*(.+?)\*", text, re.DOTALL)
        question = " ".join(asked[1].split()) if asked else ""
        picture = f"[![{title}](thumbnails/{path.stem}.png)]({path.stem}.md)"
        rows.append((picture, f"**[{title}]({path.stem}.md)**<br>{question}"))
    return table(("", "notebook"), rows)


def shown_on(page: str) -> list[dict[str, Any]]:
    """What the commands of a page of `laboratories` printed when they were run last."""
    text = (SHOWN / f"{page}.json").read_text(encoding="utf-8")
    return json.loads(text)["shown"]


def costs() -> str:
    """Processor seconds and memory of every command of the pages of `laboratories`."""
    rows = []
    for path in sorted(SHOWN.glob("*.json")):
        for one in shown_on(path.stem):
            page = f"[{path.stem.replace('_', ' ')}](laboratories/{path.stem}.md)"
            numbers = str(one.get("cpu_seconds", "-")), str(one["memory_mb"])
            rows.append((page, code(" ".join(one["command"].split()[:2])), *numbers))
    return table(("campaign", "command", "processor time [s]", "largest memory [MB]"), rows)


def plan_file() -> str:
    """The example of a plan file, as `jbw plan --example` prints it."""
    from click.testing import CliRunner

    from jbw.cli import cli

    return f"```toml\n{CliRunner().invoke(cli, ['plan', '--example']).output}```"


def powers() -> str:
    """Rows of numbers of references, thresholds and powers of the test of a watch."""
    from jbw.watch.detection import power, threshold

    return "\n".join(
        f"| {num} | {threshold(1e-3, 2, num):.0f} | {power(1e-3, 2, num, 5.0):.2f} |"
        for num in (5, 6, 8, 12, 20, 50)
    )


def code(text: str) -> str:
    """Text in code font, within a row of a table."""
    return f"`{text}`"


def table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    """A table in Markdown."""
    cells = [head, ("---",) * len(head), *rows]
    return "\n".join(f"| {' | '.join(map(escaped, row))} |" for row in cells)


def escaped(cell: str) -> str:
    """A cell whose bars are no borders; within code they are none anyway, and a backslash shows."""
    parts = re.split(r"(`[^`]*`)", cell)
    return "".join(part if part[:1] == "`" else part.replace("|", r"\|") for part in parts)


MAKERS: dict[str, Callable[..., str]] = {
    "include": included,
    "commands": commands,
    "campaign": campaign_keys,
    "costs": costs,
    "kinds": kinds,
    "roles": roles,
    "laws": laws,
    "equation": equation,
    "equations": equations,
    "figure": figure,
    "findings": findings,
    "words": explained_words,
    "gallery": gallery,
    "notebook": notebook,
    "plan": plan_file,
    "powers": powers,
}
