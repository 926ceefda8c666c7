"""Refusals: any fault of a scene or a command line gives one line and exit status 2.

The cases come from the descriptions of custom fields, options and command lines, so new ones are
tested without a change here.
"""

import argparse
import runpy
from pathlib import Path

import mujoco
import numpy as np
import pytest
from scenes import CUBE, xml

import command_line
from independent import MODELS, REPOSITORY, status_of
from sim.mjcf.fields import METHOD, NUMERICS, PRESSURE, Number

SCRIPTS = sorted(
    path.name for path in (REPOSITORY / "scripts").glob("*.py") if "def main(" in path.read_text()
)

FIELDS = {name.replace("<name>", "swell"): field for name, field in NUMERICS.items()}


def valid_value(number: Number) -> float:
    return 1.0 if number.allows(1.0) else number.least


def bad_values(number: Number) -> list[float]:
    """Values that are not allowed for a number."""
    found = [np.nan, np.inf]
    found += [np.nextafter(number.least, -np.inf), np.nextafter(number.most, np.inf)]
    found += [number.least] * number.is_above + [valid_value(number) + 0.5] * number.is_whole
    assert not any(number.allows(value) for value in found)
    return found


def bad_numerics() -> list[tuple[str, list[float]]]:
    """Names and numbers of custom numerics with one fault each."""
    cases = []
    for base, kind in FIELDS.items():
        counts = [n for n in (0, 1, 2, 3, 5, 7, 8, 37) if n not in kind.allowed_counts and n > 0]
        for name in (base, f"{base}_cube") if kind.per_geom else (base,):
            cases += [(name, [valid_value(kind.numbers[0])] * count) for count in counts]
            full_row = list(kind.numbers) * (kind.allowed_counts[-1] // len(kind.numbers))
            for i, number in enumerate(full_row[: max(len(kind.numbers), 2)]):
                for value in bad_values(number):
                    values = [valid_value(other) for other in full_row]
                    values[i] = value
                    cases.append((name, values))
        if not kind.per_geom:
            cases.append((f"{base}_x" if base in NUMERICS else "wave", [1.0]))
        else:
            values = [valid_value(kind.numbers[0])] * kind.allowed_counts[0]
            cases.append((f"{base}_nobody", values))
    return cases


def bad_custom() -> dict[str, str]:
    """Elements of a scene's <custom>, each of which must be refused."""
    found = {
        f"{name} {' '.join(f'{v:g}' for v in values[:7])}":
        f'<numeric name="{name}" data="{" ".join(repr(float(v)) for v in values)}"/>'
        for name, values in bad_numerics()
    }  # fmt: skip
    for name in (METHOD, f"{METHOD}_cube", PRESSURE):
        for text in ("magic", "linear:x", "patches:-1", "patches:nan", "chord:1e9", "chord:1.5",
                     "reference:0", "linear/", "patches:1e-3:2"):  # fmt: skip
            found[f"{name} {text}"] = f'<text name="{name}" data="{text}"/>'
    for name in (f"{METHOD}s", f"{METHOD}_nobody", f"{PRESSURE}s", "buoyancy", "water"):
        found[f"text {name}"] = f'<text name="{name}" data="linear"/>'
    return found


def bad_options() -> dict[str, str]:
    """MuJoCo's options with a number that is not finite."""
    option = mujoco.MjModel.from_xml_string("<mujoco/>").opt
    found = {}
    for name in sorted(n for n in dir(option) if not n.startswith("_")):
        value = getattr(option, name)
        if isinstance(value, float) or (isinstance(value, np.ndarray) and value.dtype == float):
            for bad in ("nan", "inf", "-inf"):
                rest = " 0" * (np.size(value) - 1)
                found[f"{name} {bad}"] = f'<option {name}="{bad}{rest}"/>'
    return found


def is_refusal(status: int, printed: str) -> bool:
    return status == 2 and printed.count("\n") == 1 and printed.endswith("\n")


def not_refused(scenes: dict[str, str], path: Path, capfd) -> str:
    """The scenes, by their cases, that run.py does not refuse in one line."""
    found = []
    for case, text in scenes.items():
        path.write_text(text)
        status = status_of("run.py", path, "--no-record", "--duration", "0.01")
        printed = capfd.readouterr().err
        if not is_refusal(status, printed):
            found.append(f"{case}: {status} {printed}")
    return "\n".join(found)


def test_the_scene_of_the_refusals_is_valid(tmp_path, capfd):
    scene = tmp_path / "s.xml"
    scene.write_text(xml(CUBE))
    assert status_of("run.py", scene, "--no-record", "--duration", "0.01", "--quiet") == 0
    assert capfd.readouterr().err == ""


def test_every_bad_custom_field_is_refused_in_one_line(tmp_path, capfd):
    density, scenes = '<numeric name="water_density" data="1025"/>', {}
    for case, element in bad_custom().items():
        text = xml(custom=element)
        is_double = 'name="water_density"' in element
        scenes[case] = text.replace(density, "", 1) if is_double else text
    assert len(scenes) > 300
    assert not_refused(scenes, tmp_path / "s.xml", capfd) == ""


def test_every_option_that_is_not_finite_is_refused_in_one_line(tmp_path, capfd):
    scenes = {case: xml(option=element) for case, element in bad_options().items()}
    assert len(scenes) > 20
    assert not_refused(scenes, tmp_path / "s.xml", capfd) == ""


class CapturedError(Exception):
    """An exception that carries a script's parser out of its main."""


def parser_of(script: str, monkeypatch) -> argparse.ArgumentParser:
    def capture(self, *_):
        raise CapturedError(self)

    monkeypatch.setattr(command_line.Parser, "parse_args", capture)
    with pytest.raises(CapturedError) as caught:
        runpy.run_path(str(REPOSITORY / "scripts" / script))["main"]([])
    monkeypatch.undo()
    return caught.value.args[0]


def bad_arguments(parser: argparse.ArgumentParser, folder) -> list[list[str]]:
    """Command lines with one fault each."""
    required = [str(MODELS / "cube.xml") for a in parser._actions if not a.option_strings]
    cases = [["--no-such-option"], [*required, "--no-such-option"]]
    if not any(action.nargs in ("+", "*") for action in parser._actions):
        cases.append([*required, "", "a", "b"])
    for action in parser._actions:
        if isinstance(action, argparse._HelpAction):
            continue
        option = action.option_strings[:1]
        if action.nargs == 0:
            cases.append([*required, f"{option[0]}=1"])
            continue
        words: list[str] = []
        if action.choices is not None:
            words = ["", "nonsense"]
        elif action.type in (None, str):
            continue
        elif getattr(action.type, "__name__", "") == "Path":
            words = [str(folder / (300 * "x"))]
            words += [str(folder)] * (action.metavar not in ("FOLDER", "DIR"))
        else:  # numbers
            words = ["", "x", "nan", "inf", "-inf", "-1", "1e300", "1e-300x", "0x"]
        for word in words:
            cases.append([*required, *option, word] if option else [word])
        if option and action.nargs is None:
            cases.append([*required, *option])  # without a value
    return cases


@pytest.mark.parametrize("script", SCRIPTS)
def test_every_bad_command_line_is_refused_in_one_line(script, tmp_path, monkeypatch, capfd):
    parser = parser_of(script, monkeypatch)
    monkeypatch.chdir(tmp_path)
    accepted = {}
    for arguments in bad_arguments(parser, tmp_path):
        status = status_of(script, *arguments)
        printed = capfd.readouterr().err
        if not is_refusal(status, printed):
            accepted[" ".join(arguments)[-200:]] = (status, printed[-300:])
    assert accepted == {}
    assert list(tmp_path.iterdir()) == []
