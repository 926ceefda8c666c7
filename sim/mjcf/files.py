"""Files: finds the files that an MJCF file is compiled from."""

from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

from sim.mjcf.fields import names_file

FOLDERS = ("meshdir", "texturedir", "assetdir")
"""Attributes of <compiler> that name folders."""


def model_files(path: Path) -> list[Path]:
    """An MJCF file and all existing files that it or its includes name: includes, meshes, height
    fields, textures, seas. A file that is not XML names no others. Nothing waits for a pipe."""
    files: list[Path] = [path]
    folders, names, waiting = [path.parent], [], [path]
    while waiting:
        for element in _elements(waiting.pop()):
            folders += [path.parent / element.attrib[f] for f in FOLDERS if f in element.attrib]
            if "file" in element.attrib:
                names.append(element.attrib["file"])
            if element.tag == "text" and names_file(element.attrib.get("name", "")):
                names.append(element.attrib.get("data", ""))
            included = path.parent / element.attrib.get("file", "")
            if element.tag == "include" and included.is_file() and included not in files:
                files.append(included)
                waiting.append(included)
    for name in names:
        paths = [folder / name for folder in folders]
        files += [named for named in paths if named.exists() and not named.is_dir()]
    return list(dict.fromkeys(files))


def _elements(path: Path) -> Iterator[ElementTree.Element]:
    if not path.is_file():
        return
    try:
        yield from ElementTree.parse(path).iter()
    except (ElementTree.ParseError, OSError, UnicodeDecodeError):
        return
