"""Documentation: the table of fields matches the program, links have targets, scripts exist."""

import re

import pytest

from independent import REPOSITORY
from sim.mjcf.fields import described

PAGES = sorted(
    path
    for pattern in ("*.md", "models/*.md", "scripts/**/*.md", "sim/**/*.md")
    for path in REPOSITORY.glob(pattern)
)


def anchors(page) -> set[str]:
    """Anchors of a page's headings, as code hosting sites make them."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-") for h in headings}


def test_the_table_of_fields_matches_the_program():
    page = (REPOSITORY / "sim" / "mjcf" / "README.md").read_text()
    table = page.split("| field | numbers | meaning |\n| --- | --- | --- |\n")[1].split("\n\n")[0]
    rows = [f"| `{name}` | {value} | {meaning} |" for name, value, meaning in described()]
    assert table.splitlines() == rows


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(REPOSITORY)))
def test_links_have_targets(page):
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text()):
        if target.startswith("http"):
            continue
        path, _, anchor = target.partition("#")
        linked = (page.parent / path).resolve() if path else page
        assert linked.exists(), target
        assert not anchor or anchor in anchors(linked), target


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(REPOSITORY)))
def test_commands_name_existing_scripts(page):
    for script in re.findall(r"python (scripts/[\w/]+\.py)", page.read_text()):
        assert (REPOSITORY / script).is_file(), script


def test_the_ten_lines_of_the_readme_float_a_box(capsys):
    code = re.findall(r"```python\n(.*?)```", (REPOSITORY / "README.md").read_text(), re.DOTALL)[0]
    assert len([line for line in code.splitlines() if line]) == 10
    names: dict = {}
    exec(code, names)
    assert len(capsys.readouterr().out.splitlines()) == 20
    # a box of 600 kg/m^3 in water of 1025 lies with its centre 0.034 m below the surface
    assert abs(names["data"].body("box").xpos[2] + 0.034) < 0.1  # the amplitude of the wave
