"""The ROS 2 package: its launch files start the command, its settings are read, and RViz shows topics that exist.

`launch` itself is not on PyPI: the files are expanded here as `launch` would, and their commands run.
"""

import ast
import os
import random
import re
import shlex
import subprocess
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml

import palpate

PACKAGE = Path(__file__).resolve().parents[3] / "ros2" / "palpate_ros"
ARMS = ["franka", "gen3", "iiwa", "ur"]


def expanded(text: str, values: dict[str, str]) -> str:
    """A text with its substitutions replaced; every variable in them must be declared."""
    text = text.replace("$(find-pkg-share palpate_ros)", str(PACKAGE))
    return re.sub(r"\$\(var (\w+)\)", lambda found: values[found[1]], text)


def command_line(text: str, values: dict[str, str]) -> str:
    """The words of a `cmd`: `launch` removes escapes, then splits the text between substitutions into words."""
    line = ""
    for part in re.split(r"(\$\([^)]*\))", text):
        if part.startswith("$("):
            line += expanded(part, values)
            continue
        plain = re.sub(r"\\(.)", r"\1", part)
        words = " ".join(shlex.split(plain))
        line += " " * plain.startswith(" ") + words + " " * (plain.endswith(" ") and words != "")
    return line


def command(launch: Path, given: dict[str, str]) -> list[str]:
    """The commands that a launch file executes, with arguments as for `ros2 launch`."""
    values: dict[str, str] = {}
    commands: list[str] = []
    for node in ElementTree.parse(launch).getroot():
        own = {name: expanded(text, values) for name, text in node.attrib.items()}
        if node.tag == "arg":
            name = own["name"]
            assert own["description"], name
            if name not in given and "default" not in own:
                raise KeyError(name)
            values[name] = given[name] if name in given else own["default"]
        elif node.tag == "let":
            condition = own.get("if", "true") == "true" and own.get("unless", "false") == "false"
            if condition:
                values[own["name"]] = own["value"]
        elif node.tag == "include":
            passed = {arg.attrib["name"]: expanded(arg.attrib["value"], values) for arg in node}
            commands += command(Path(own["file"]), passed)
        elif node.tag == "executable":
            assert own["shell"] == "true"
            commands.append(command_line(node.attrib["cmd"], values))
        else:
            assert (node.tag, own["pkg"]) == ("node", "rviz2")
            parts = {part.tag: [expanded(text, values) for text in part.attrib.values()] for part in node}
            assert parts["remap"] == ["/robot_description", values["robot"]]
            assert parts["param"] == ["use_sim_time", values["use_sim_time"]]
    assert not set(given) - set(values), "an argument that the file does not declare"
    return commands


def run(launch: str, tmp_path: Path, **given: str) -> subprocess.CompletedProcess[str]:
    domain = random.randrange(120, 200)
    given["flags"] = f"--localhost --domain {domain} --duration 1 {given.get('flags', '')}"
    own = {"robot": "kinova_gen3", "field": str(tmp_path / "field.npz"), **given}
    [line] = command(PACKAGE / "launch" / launch, own)
    folder = Path(palpate.__file__).parents[4] / "bin"
    env = {**os.environ, "PATH": f"{folder}:{os.environ['PATH']}"}
    return subprocess.run(line, shell=True, capture_output=True, text=True, env=env)


@pytest.mark.parametrize("arm", ARMS)
def test_mapping_starts_for_every_arm_and_keeps_its_field(arm: str, tmp_path: Path) -> None:
    done = run("mapping.launch.xml", tmp_path, arm=arm)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "field.npz").is_file()


def test_the_guard_starts_with_and_without_moveit_and_wants_a_limit(tmp_path: Path) -> None:
    for moveit in ("true", "false"):
        [line] = command(PACKAGE / "launch" / "guard.launch.xml", {"limit": "25", "moveit": moveit})
        words = shlex.split(line)
        assert words[words.index("--guard") + 1] == "25" and ("--guard-moveit" in words) == (moveit == "true")
        done = run("guard.launch.xml", tmp_path, limit="25", moveit=moveit)
        assert done.returncode == 0, done.stderr
    with pytest.raises(KeyError, match="limit"):
        command(PACKAGE / "launch" / "guard.launch.xml", {})


def test_settings_may_lie_in_a_folder_with_blanks(tmp_path: Path) -> None:
    own = tmp_path / "my settings.toml"
    own.write_text((PACKAGE / "config" / "ur.toml").read_text())
    done = run("guard.launch.xml", tmp_path, limit="25", settings=str(own))
    assert done.returncode == 0, done.stderr


def test_settings_of_the_arms_say_sign_and_gravity() -> None:
    assert sorted(path.stem for path in (PACKAGE / "config").iterdir()) == ARMS
    for arm in ARMS:
        touch = palpate.default_settings(PACKAGE / "config" / f"{arm}.toml")["touch"]
        # A live session cannot determine them from the log in advance, so both must be given.
        assert touch["torque_sign"] in ("plus", "minus") and touch["gravity"] in ("included", "removed")


def test_rviz_shows_topics_that_palpate_publishes() -> None:
    assert command(PACKAGE / "launch" / "view.launch.xml", {}) == []
    config = yaml.safe_load((PACKAGE / "rviz" / "palpate.rviz").read_text())
    displays = config["Visualization Manager"]["Displays"]
    page = (PACKAGE.parents[1] / "docs/guide/src/live.md").read_text()
    for display, kind in {"PointCloud2": "PointCloud2", "Wrench": "WrenchStamped"}.items():
        topics = [shown["Topic"]["Value"] for shown in displays if shown["Class"].endswith(f"/{display}")]
        assert topics and all(f"| `{topic}` | `{kind}` |" in page for topic in topics)


def test_time_of_a_simulation_is_taken_where_it_is_asked_for() -> None:
    for launch, given in {"mapping": {}, "guard": {"limit": "25"}}.items():
        for is_simulated in ("false", "true"):
            arguments = {**given, "use_sim_time": is_simulated}
            [line] = command(PACKAGE / "launch" / f"{launch}.launch.xml", arguments)
            assert ("--sim-time" in shlex.split(line)) == (is_simulated == "true")


def test_the_service_is_laid_out_as_on_the_wire() -> None:
    """The fields of the service are those of the test's peer on CycloneDDS, which palpate understands."""
    peer = ast.parse((PACKAGE.parents[1] / "scripts/dds_messages.py").read_text())
    calls = (node for node in ast.walk(peer) if isinstance(node, ast.Call) and node.args)
    found = next(call.args[1:] for call in calls if ast.unparse(call.args[0]) == "'palpate_ros/AskTrajectory'")
    text = (PACKAGE / "srv" / "AskTrajectory.srv").read_text()
    for part, of_peer in zip(text.split("---"), found, strict=True):
        fields = [line.split() for line in part.splitlines() if line and not line.startswith("#")]
        kinds = {"string": "str", "uint32[]": "sequence[uint32]", "trajectory_msgs/JointTrajectory": "JointTrajectory"}
        wanted = [(field, kinds.get(kind, kind)) for kind, field in fields]
        assert isinstance(of_peer, ast.Dict)
        types = zip(of_peer.keys, of_peer.values, strict=True)
        assert [(ast.literal_eval(name), ast.unparse(kind)) for name, kind in types if name] == wanted
    functions = (node for node in ast.walk(peer) if isinstance(node, ast.FunctionDef))
    service = next(ast.unparse(function) for function in functions if function.name == "_service")
    assert "client=uint64, number=int64, **fields" in service


def test_the_package_has_the_version_and_the_dependencies_of_its_files() -> None:
    manifest = ElementTree.parse(PACKAGE / "package.xml").getroot()
    assert manifest.findtext("version") == palpate.__version__
    needs = {node.text for node in manifest if node.tag == "exec_depend"}
    assert {"launch_xml", "ros2launch", "rviz2", "rviz_default_plugins", "rosidl_default_runtime"} <= needs
    assert manifest.findtext("member_of_group") == "rosidl_interface_packages"
    installed = (PACKAGE / "CMakeLists.txt").read_text()
    folders = sorted(path.name for path in PACKAGE.iterdir() if path.is_dir())
    assert folders == ["config", "launch", "rviz", "srv"] and all(folder in installed for folder in folders)
