# SPDX-License-Identifier: Apache-2.0
"""The stand-in for `ros2` against a node that is really there.

What becomes or starts processes, or ends on a signal, is run as one; the other commands are called in this process, for
to start Python takes longer than they do.
"""

import io
import os
import signal
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import pytest
import yaml

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tools"))

from ros2_standin import graph
from ros2_standin.cli import main

pytestmark = pytest.mark.timeout(300)
ROS2 = Path(__file__).resolve().parents[1] / "tools" / "bin" / "ros2"
ENVIRONMENT = {**os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
ABSENT = "/nope"

NODE = """
import rclpy
from labyrinth_msgs.action import PlaySequence
from labyrinth_msgs.msg import BallState
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.action import ActionServer
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String
from std_srvs.srv import SetBool

rclpy.init()
node = rclpy.create_node("rig", namespace="/real")
node.declare_parameter("rate", 50.0, ParameterDescriptor(
    floating_point_range=[FloatingPointRange(from_value=1.0, to_value=200.0)]))
node.declare_parameter("axes", ["x", "y"])
latched = node.create_publisher(String, "note", QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
latched.publish(String(data="said once"))
ball = node.create_publisher(BallState, "ball", 10)
state = BallState(visible=True, x=0.125, y=0.0625)
state.header.frame_id = "board"
node.create_timer(0.02, lambda: ball.publish(state))

def arm(request, response):
    response.success, response.message = request.data, "armed" if request.data else "not armed"
    return response

def play(handle):
    handle.publish_feedback(PlaySequence.Feedback(trials=handle.request.trials, phase="playing", progress=0.5))
    handle.succeed()
    return PlaySequence.Result(success=True, message="played " + handle.request.sequence, bags=["a.mcap"])

node.create_service(SetBool, "arm", arm)
gate = LifecycleNode("gate", namespace="/real", enable_communication_interface=True)
server = ActionServer(node, PlaySequence, "/play_sequence", play)
print("ready", flush=True)
executor = SingleThreadedExecutor()
executor.add_node(node)
executor.add_node(gate)
executor.spin()
"""


@pytest.fixture(scope="module", autouse=True)
def rig(module_domain: int) -> Iterator[None]:
    ENVIRONMENT["ROS_DOMAIN_ID"] = str(module_domain)
    process = subprocess.Popen([sys.executable, "-c", NODE], env=ENVIRONMENT, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        assert process.stdout.readline() == "ready\n"
        yield
    finally:
        process.kill()
        process.wait()


def ros2(*arguments: str, **environment: str) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of one command."""
    if arguments[:1] == ("run",):
        return process(*arguments, **environment)
    out, err = io.TextIOWrapper(io.BytesIO(), "utf-8"), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        for name, value in {**ENVIRONMENT, **environment}.items():
            patch.setenv(name, value)
        if ABSENT in arguments:  # however long it is looked for
            patch.setattr(graph, "NAMED_TIME", 0.2)
        try:
            code = main(arguments)
        except SystemExit as end:
            code = end.code
    out.flush()
    out.seek(0)
    # As sys.exit does it with text.
    told = f"{err.getvalue()}{code}\n" if isinstance(code, str) else err.getvalue()
    return 1 if isinstance(code, str) else code or 0, out.read(), told


def process(*arguments: str, **environment: str) -> tuple[int, str, str]:
    """The same of a process."""
    done = subprocess.run(
        [sys.executable, str(ROS2), *arguments], env={**ENVIRONMENT, **environment}, capture_output=True, text=True,
        timeout=120,
    )  # fmt: skip
    return done.returncode, done.stdout, done.stderr


def listed(*arguments: str, line: str) -> list[str]:
    """Lines of a listing, asked for again until discovery has brought `line`."""
    for _ in range(20):
        code, out, _ = ros2(*arguments)
        assert code == 0
        if line in out.splitlines():
            break
    return out.splitlines()


def test_topic_list_shows_names_and_types() -> None:
    lines = listed("topic", "list", "-t", line="/real/ball [labyrinth_msgs/msg/BallState]")
    assert "/real/ball [labyrinth_msgs/msg/BallState]" in lines
    assert "/real/note [std_msgs/msg/String]" in lines
    assert not any("/_" in line for line in lines)


def test_topic_echo_prints_a_message_as_yaml_and_a_separator() -> None:
    code, out, _ = process("topic", "echo", "--once", "/real/ball")
    body, separator, rest = out.partition("---\n")
    assert (code, separator, rest) == (0, "---\n", "")
    assert out.startswith("header:\n  stamp:\n    sec: 0\n    nanosec: 0\n  frame_id: board\nvisible: true\nx: 0.125\n")
    assert yaml.safe_load(body)["y"] == 0.0625


def test_topic_echo_selects_fields() -> None:
    assert ros2("topic", "echo", "--once", "/real/ball", "--field", "header.frame_id") == (0, "board\n---\n", "")
    code, _, err = ros2("topic", "echo", "--once", "/real/ball", "--field", "nope")
    assert (code, err.splitlines()[0].startswith("Invalid field 'nope':")) == (1, True)


def test_topic_echo_reaches_a_latched_message_said_before() -> None:
    assert ros2("topic", "echo", "--once", "/real/note") == (0, "data: said once\n---\n", "")


def test_topic_echo_of_an_unknown_topic_fails_as_the_real_one() -> None:
    code, out, err = ros2("topic", "echo", ABSENT)
    assert (code, err) == (1, "Could not determine the type for the passed topic\n")
    assert out == "WARNING: topic [/nope] does not appear to be published yet\n"


@pytest.mark.study
def test_topic_info_counts_the_ends() -> None:
    code, out, _ = ros2("topic", "info", "/real/ball")
    assert (code, out) == (0, "Type: labyrinth_msgs/msg/BallState\nPublisher count: 1\nSubscription count: 0\n")
    code, out, _ = ros2("topic", "info", "-v", "/real/ball")
    assert code == 0
    assert "Node name: rig\n" in out
    assert ros2("topic", "info", ABSENT)[::2] == (1, "Unknown topic '/nope'\n")
    assert ros2("topic", "type", "/real/ball")[:2] == (0, "labyrinth_msgs/msg/BallState\n")


def test_topic_hz_reports_until_interrupted() -> None:
    process = subprocess.Popen(
        [sys.executable, str(ROS2), "topic", "hz", "/real/ball"], env=ENVIRONMENT, stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None
        first, second = process.stdout.readline(), process.stdout.readline()
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=60)
    finally:
        process.kill()
    assert first.startswith("average rate: ")
    assert float(first.removeprefix("average rate: ")) > 0
    assert second.startswith("\tmin: ")
    assert "window: " in second


def test_topic_pub_reaches_a_subscriber_and_refuses_a_wrong_field() -> None:
    listener = subprocess.Popen(
        [sys.executable, str(ROS2), "topic", "echo", "--once", "/said", "labyrinth_msgs/msg/Srg"],
        env=ENVIRONMENT,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        # The publisher may know of the listener before the listener knows of the publisher, so once may be too early.
        text = "{header: auto, signals: [a, b], k: [1, 2]}"
        code, out, _ = ros2("topic", "pub", "--times", "10", "-r", "5", "/said", "labyrinth_msgs/msg/Srg", text)
        heard, _ = listener.communicate(timeout=60)
    finally:
        listener.kill()
    assert code == 0
    assert "publishing #1: labyrinth_msgs.msg.Srg(" in out
    message = yaml.safe_load(heard.partition("---\n")[0])
    assert (message["signals"], message["k"]) == (["a", "b"], [1.0, 2.0])
    assert message["header"]["stamp"]["sec"] > 0
    code, _, err = ros2("topic", "pub", "-w", "0", "--times", "1", "/said", "std_msgs/msg/String", "{text: x}")
    assert code == 1
    assert err.startswith("Failed to populate field: ")
    assert ros2("topic", "pub", "/said", "no/such")[::2] == (1, "The passed message type is invalid\n")


def test_node_list_names_the_node_once() -> None:
    assert listed("node", "list", line="/real/rig") == ["/real/gate", "/real/rig"]


@pytest.mark.study
def test_node_info_tells_what_the_node_offers() -> None:
    code, out, _ = ros2("node", "info", "/real/rig")
    assert code == 0
    titles = [line.strip() for line in out.splitlines() if line.startswith("  ") and line.endswith(":")]
    assert titles == [
        "Subscribers:",
        "Publishers:",
        "Service Servers:",
        "Service Clients:",
        "Action Servers:",
        "Action Clients:",
    ]
    assert "    /real/ball: labyrinth_msgs/msg/BallState\n" in out.split("Publishers:")[1].split("Service Servers:")[0]
    assert "    /play_sequence: labyrinth_msgs/action/PlaySequence\n" in out.split("Action Servers:")[1]
    assert ros2("node", "info", ABSENT)[::2] == (1, "Unable to find node '/nope'\n")


def test_action_info_names_clients_and_servers() -> None:
    code, out, _ = ros2("action", "info", "-t", "/play_sequence")
    assert code == 0
    assert out == (
        "Action: /play_sequence\nAction clients: 0\nAction servers: 1\n"
        "    /real/rig [labyrinth_msgs/action/PlaySequence]\n"
    )


def test_interfaces_are_listed_by_kind() -> None:
    code, out, _ = ros2("interface", "list")
    assert code == 0
    assert [line for line in out.splitlines() if line[0] != " "] == ["Messages:", "Services:", "Actions:"]
    assert ros2("interface", "list", "-a")[1] in out
    assert "    labyrinth_msgs/action/PlaySequence\n" in out
    assert "_" not in "".join(line.split("/")[-1] for line in out.splitlines() if line[0] == " ")


@pytest.mark.study
def test_parameters_are_dumped_to_a_file_and_loaded_from_it(tmp_path: Path) -> None:
    code, out, _ = ros2("param", "dump", "/real/rig")
    assert code == 0
    tree = yaml.safe_load(out)
    parameters = tree["/real/rig"]["ros__parameters"]
    assert parameters["axes"] == ["x", "y"]
    parameters.clear()
    parameters.update(rate=33.0, axes=["z"])
    file = tmp_path / "rig.yaml"
    file.write_text(yaml.safe_dump(tree))
    code, out, _ = ros2("param", "load", "/real/rig", str(file))
    assert (code, sorted(out.splitlines())) == (
        0,
        ["Set parameter axes successful", "Set parameter rate successful"],
    )
    assert ros2("param", "get", "--hide-type", "/real/rig", "rate")[1] == "33.0\n"
    ros2("param", "set", "/real/rig", "axes", "[x, y]")
    assert ros2("param", "load", "/real/rig", str(tmp_path / "none.yaml"))[0] == 1


def test_a_lifecycle_node_is_taken_from_state_to_state() -> None:
    assert listed("lifecycle", "nodes", line="/real/gate") == ["/real/gate"]
    assert ros2("lifecycle", "get", "/real/gate")[:2] == (0, "unconfigured [1]\n")
    assert "- configure [1]\n\tStart: unconfigured\n\tGoal: configuring\n" in ros2("lifecycle", "list", "/real/gate")[1]
    assert ros2("lifecycle", "set", "/real/gate", "configure")[:2] == (0, "Transitioning successful\n")
    assert ros2("lifecycle", "get")[1] == "/real/gate: inactive [2]\n"
    code, _, err = ros2("lifecycle", "set", "/real/gate", "configure")
    assert (code, err.splitlines()[0]) == (1, "Unknown transition requested, available ones are:")


def test_parameters_are_listed_read_and_set() -> None:
    code, out, _ = ros2("param", "list", "/real/rig")
    assert code == 0
    assert {"  axes", "  rate"} <= set(out.splitlines())
    assert ros2("param", "get", "/real/rig", "axes")[:2] == (0, "String values are: ['x', 'y']\n")
    assert ros2("param", "set", "/real/rig", "rate", "20.0")[:2] == (0, "Set parameter successful\n")
    assert ros2("param", "get", "/real/rig", "rate")[:2] == (0, "Double value is: 20.0\n")


def test_a_parameter_is_described_with_its_range() -> None:
    told = "Parameter name: rate\n  Type: double\n  Constraints:\n    Min value: 1.0\n    Max value: 200.0\n"
    assert ros2("param", "describe", "/real/rig", "rate")[:2] == (0, told)
    assert ros2("param", "describe", ABSENT, "rate")[::2] == (1, "Node not found\n")


def test_a_refused_parameter_tells_the_reason() -> None:
    code, out, err = ros2("param", "set", "/real/rig", "rate", "999.0")
    assert (code, out) == (0, "")
    assert err.startswith("Setting parameter failed: ")
    assert ros2("param", "get", ABSENT, "rate")[::2] == (1, "Node not found\n")


def test_service_call_prints_request_and_response() -> None:
    code, out, _ = ros2("service", "call", "/real/arm", "std_srvs/srv/SetBool", "{data: true}")
    assert code == 0
    assert "requester: making request: std_srvs.srv.SetBool_Request(data=True)\n" in out
    assert out.endswith("response:\nstd_srvs.srv.SetBool_Response(success=True, message='armed')\n\n")
    arm = "/real/arm [std_srvs/srv/SetBool]"
    assert arm in listed("service", "list", "-t", line=arm)
    assert ros2("service", "call", "/real/arm", "std_srvs/srv/No")[::2] == (1, "The passed service type is invalid\n")


def test_action_send_goal_prints_feedback_and_result() -> None:
    code, out, _ = ros2(
        "action", "send_goal", "-f", "/play_sequence", "labyrinth_msgs/action/PlaySequence", "{sequence: p, trials: 3}"
    )
    assert code == 0
    for part in ("Goal accepted with ID: ", "Feedback:\n    trial: 0\ntrials: 3\n", "message: played p\n"):
        assert part in out
    assert out.endswith("Goal finished with status: SUCCEEDED\n")
    play = "/play_sequence [labyrinth_msgs/action/PlaySequence]"
    assert listed("action", "list", "-t", line=play) == [play]


def test_interface_show_unfolds_nested_types() -> None:
    code, out, _ = ros2("interface", "show", "--no-comments", "labyrinth_msgs/msg/BallEvent")
    lines = out.splitlines()
    assert code == 0
    assert lines[:4] == [
        "uint8 LOST=0",
        "uint8 SUPPLIED=1",
        "std_msgs/Header header",
        "\tbuiltin_interfaces/Time stamp",
    ]
    assert ros2("interface", "show", "nope/msg/No")[::2] == (1, "Unknown package 'nope'\n")


def test_unknown_words_are_usage_errors() -> None:
    assert process("nope")[0] == 2
    for words in (["nope"], ["topic", "nope"], ["topic", "echo"], ["topic", "list", "--nope"]):
        code, out, err = ros2(*words)
        assert (code, out) == (2, "")
        assert err.startswith("usage: ros2")


def test_help_says_at_once_that_this_is_a_stand_in_and_what_the_real_one_has_besides() -> None:
    for words in ([], ["-h"], ["topic"], ["topic", "echo", "-h"]):
        code, out, err = ros2(*words, COLUMNS="1000")
        assert (code, out[:11], err) == (0, "usage: ros2", "")
    first = ros2(COLUMNS="1000")[1].split("\n\n")[1]
    assert first.startswith("This is a stand-in for the `ros2` of ROS 2")
    for missing in ("bag", "daemon", "topic bw, delay, find", "service echo"):
        assert missing in first


def test_what_only_the_real_one_has_is_named_as_such() -> None:
    for words, name in ((["bag", "record"], "bag"), (["topic", "bw", "/x"], "topic bw"), (["daemon"], "daemon")):
        code, out, err = ros2(*words)
        assert (code, out) == (2, "")
        assert err.startswith(
            f"ros2: this is a stand-in for the `ros2` of ROS 2, which PyPI does not have, and it has no `{name}`."
        )


@pytest.fixture
def prefix(tmp_path: Path) -> str:
    """AMENT_PREFIX_PATH with one more package, whose executable tells its arguments and waits for a signal."""
    marker = tmp_path / "share" / "ament_index" / "resource_index" / "packages" / "tiny"
    marker.parent.mkdir(parents=True)
    marker.touch()
    executable = tmp_path / "lib" / "tiny" / "wait"
    executable.parent.mkdir(parents=True)
    executable.write_text(
        textwrap.dedent(f"""\
        #!{sys.executable}
        import os, signal, sys
        if "--fail" in sys.argv:
            sys.exit(3)
        print(os.getpid(), *sys.argv[1:], flush=True)
        signal.pause()
        """)
    )
    executable.chmod(0o755)
    return os.pathsep.join([str(tmp_path), os.environ["AMENT_PREFIX_PATH"]])


def test_run_becomes_the_node_so_signals_reach_it(prefix: str) -> None:
    process = subprocess.Popen(
        [sys.executable, str(ROS2), "run", "tiny", "wait", "--ros-args", "-p", "a:=1"],
        env={**ENVIRONMENT, "AMENT_PREFIX_PATH": prefix},
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == f"{process.pid} --ros-args -p a:=1\n"
        process.terminate()
        assert process.wait(timeout=60) == -signal.SIGTERM
    finally:
        process.kill()


def test_run_passes_the_exit_code_on_and_names_what_is_missing(prefix: str) -> None:
    assert ros2("run", "tiny", "wait", "--fail", AMENT_PREFIX_PATH=prefix)[0] == 3
    assert ros2("run", "tiny", "nope", AMENT_PREFIX_PATH=prefix)[::2] == (1, "No executable found\n")
    assert ros2("run", "nope", "wait", AMENT_PREFIX_PATH=prefix)[::2] == (1, "Package 'nope' not found\n")
    assert ros2("pkg", "executables", "tiny", AMENT_PREFIX_PATH=prefix)[:2] == (0, "tiny wait\n")
    assert ros2("pkg", "prefix", "nope")[::2] == (1, "Package not found\n")


LAUNCH = """
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, GroupAction, IncludeLaunchDescription
from launch.conditions import IfCondition, UnlessCondition
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node, PushROSNamespace
from launch_ros.parameter_descriptions import ParameterValue


def generate_launch_description():
    given = LaunchConfiguration("given")
    values = {"as_text": ParameterValue(given, value_type=str), "as_yaml": given, "fixed": [1.5, 2.5]}
    return LaunchDescription([
        DeclareLaunchArgument("given", description="A number."),
        DeclareLaunchArgument("both", default_value="false", description="Whether there are two."),
        GroupAction([
            PushROSNamespace("outer"),
            Node(package="tiny", executable="wait", name="n", namespace="inner", parameters=[values],
                 remappings=[("a", "b")], arguments=["--tell", given]),
        ]),
        Node(package="tiny", executable="wait", arguments=["second"],
             condition=IfCondition(LaunchConfiguration("both"))),
        Node(package="tiny", executable="wait", arguments=["--fail"], condition=UnlessCondition("0")),
    ])
"""


def test_launch_starts_what_the_file_says_and_ends_it_on_a_signal(prefix: str, tmp_path: Path) -> None:
    file = tmp_path / "tiny.launch.py"
    file.write_text(LAUNCH)
    environment = {**ENVIRONMENT, "AMENT_PREFIX_PATH": prefix}
    process = subprocess.Popen(
        [sys.executable, str(ROS2), "launch", str(file), "given:=7"], env=environment, stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None
        said = ""
        line = ""
        while not line or "died" not in said:  # the two processes speak in any order
            told = process.stdout.readline()
            said, line = said + told, told if told.startswith("[wait-1] ") and "--ros-args" in told else line
        words = line.split()[2:]
        parameters = yaml.safe_load(Path(words[words.index("--params-file") + 1]).read_text())
        process.send_signal(signal.SIGTERM)
        out, _ = process.communicate(timeout=60)
    finally:
        process.kill()
    assert words[:7] == ["--tell", "7", "--ros-args", "-r", "__node:=n", "-r", "__ns:=/outer/inner"]
    assert words[-2:] == ["-r", "a:=b"]
    assert parameters == {"/**": {"ros__parameters": {"as_text": "7", "as_yaml": 7, "fixed": [1.5, 2.5]}}}
    assert "second" not in said
    assert "[wait-2]: process has died" in said
    assert "exit code 3" in said
    assert "[wait-1]: sending signal 'SIGINT' to process[wait-1]" in out
    assert process.returncode == 0


def test_launch_says_what_is_wrong(prefix: str, tmp_path: Path) -> None:
    file = tmp_path / "tiny.launch.py"
    file.write_text(LAUNCH)
    for words, told in (
        ([str(file)], "Required launch argument 'given' was not provided"),
        ([str(file), "given"], "malformed launch argument 'given'"),
        (["tiny", "none.launch.py"], "file 'none.launch.py' was not found in the share directory of package 'tiny'"),
        (["nope", "none.launch.py"], "Package 'nope' not found"),
    ):
        code, _, err = ros2("launch", *words, AMENT_PREFIX_PATH=prefix)
        assert (code, told in err) == (1, True), err
    file.write_text("from launch.actions import OpaqueFunction")
    code, _, err = ros2("launch", str(file), AMENT_PREFIX_PATH=prefix)
    assert (code, "OpaqueFunction" in err, "install ROS 2" in err) == (1, True, True)


def test_our_launch_files_show_their_arguments() -> None:
    for package, file, name in (
        ("eps_tunnel_analysis", "study.launch.py", "emulated"),
        ("labyrinth_hw", "hw.launch.py", "config"),
        ("labyrinth_hw", "testbed.launch.py", "seed"),
        ("labyrinth_sim", "sim.launch.py", "model"),
    ):
        code, out, _ = ros2("launch", "-s", package, file)
        assert (code, f"    '{name}':\n" in out) == (0, True)


@pytest.mark.study
@pytest.mark.realtime  # the emulated rig and what drives it end at the same time
def test_our_launch_files_bring_up_a_rig_and_its_simulation(tmp_path: Path) -> None:
    # The study includes the three other files.
    arguments = ("testbed_config:=healthy", "hw_config:=healthy", "model:=labyrinth_mx64")
    process = subprocess.Popen(
        [sys.executable, str(ROS2), "launch", "eps_tunnel_analysis", "study.launch.py", *arguments],
        env={**ENVIRONMENT, "LABYRINTH_TESTBED_DIR": str(tmp_path / "links")},
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        nodes = {"/analysis_node", "/hw_node", "/player", "/sim_node"}
        for _ in range(20):
            if nodes <= set(ros2("node", "list")[1].split()):
                break
        assert nodes <= set(ros2("node", "list")[1].split())
        assert ros2("param", "get", "--hide-type", "/sim_node", "model")[1] == "labyrinth_mx64\n"
        assert ros2("param", "get", "--hide-type", "/hw_node", "config")[1] == "healthy\n"
        assert ros2("topic", "echo", "--once", "--timeout", "60", "/real/joint_states", "--field", "name")[0] == 0
        process.send_signal(signal.SIGINT)
        out, _ = process.communicate(timeout=60)
    finally:
        process.terminate()
        process.wait(timeout=60)
    assert process.returncode == 0, out
    assert "process has died" not in out
