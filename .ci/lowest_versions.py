"""Print pip constraints: the lowest version that pyproject.toml allows of each dependency of the
package and of the extras that are given as arguments."""

import re
import sys
import tomllib
from pathlib import Path

project = tomllib.loads(Path("pyproject.toml").read_text())["project"]
extras = (project["optional-dependencies"][name] for name in sys.argv[1:])
for dependency in sum(extras, project["dependencies"]):
    name, version = re.match(r"([-\w]+)>=([.\d]+)", dependency).groups()
    print(f"{name}=={version}")
