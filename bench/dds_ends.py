"""Programs in a domain for `bench.foreign_dds`: ``python -m bench.dds_ends PART DOMAIN NODE``.

``stock`` is a node with rclpy, ``other`` one with the Python of `OTHER_PYTHON`, ``cyclone`` a participant of Cyclone
DDS, ``rosbridge`` a WebSocket client of rosbridge-server-rs, and another one a program of `make peers`. ``server`` is
Fast DDS's discovery server at a port, no program.
Each does what the lines of standard input say, and ends with it:

- ``write TOPIC [POLICY...]``, ``read TOPIC [POLICY...]``: of std_msgs/String. A policy is ``best_effort``, ``latched``,
  ``depth=N``, or ``deadline``, ``lifespan`` or ``lease`` (manual by topic) with ``=SECONDS``. Two more are types:
  ``keyed`` is test_msgs/KeyedString, and ``key`` a String whose text is a key, which it is not for ROS.
- ``publish TOPIC MARK SIZE``; a key is the last letter of the mark
- of nodes, ``serve NAME MAPPING`` and ``call NAME MAPPING`` of std_srvs/SetBool (``answered NAME MESSAGE``), ``set
  NODE``: its parameter ``rate`` to another number, and read it (``answered NODE``), ``tick SECOND`` to /clock and
  ``watch`` of it

It says ``ready``, ``heard TOPIC MARK SIZE`` and ``event TOPIC deadline|not_alive|...``. This module needs nothing of
rsb-console, since it also runs with another distribution's Python.
"""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import threading
import time
from abc import ABC, abstractmethod
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any

PROGRAMS = Path(__file__).parent / "peers/dds_programs/target/release"
_EVERY = 0.005  # s between two looks for samples, as in `dds_programs`
_MOST = 1000
"""Samples that Cyclone DDS keeps for late joiners, and that one look takes."""
_OF_WHEELS = "LD_LIBRARY_PATH", "_ROS_WHEELS_BOOTSTRAP_COMPLETE"
"""Variables that ROS's wheels set once."""
_saying = threading.Lock()


class Participant(ABC):
    """Writers and readers of a program."""

    def __init__(self) -> None:
        self._writers: dict[str, Any] = {}
        self._readers: dict[str, Any] = {}

    @abstractmethod
    def write(self, topic: str, qos: dict[str, float]) -> None: ...

    @abstractmethod
    def read(self, topic: str, qos: dict[str, float]) -> None: ...

    @abstractmethod
    def publish(self, topic: str, text: str) -> None: ...

    def run(self) -> None:
        """Do what the lines of standard input say."""
        _say("ready")
        for line in sys.stdin:
            match line.split():
                case ["write", topic, *policies]:
                    self.write(topic, _qos(policies))
                case ["read", topic, *policies]:
                    self.read(topic, _qos(policies))
                case ["publish", topic, mark, size]:
                    self.publish(topic, f"{mark} {'x' * int(size)}")
                case [order, *words]:
                    getattr(self, order)(*words)


def _qos(policies: list[str]) -> dict[str, float]:
    return {key: float(value or 1) for key, _, value in (policy.partition("=") for policy in policies)}


def _filled(kind: Any, text: str) -> Any:
    """Return a message of a type."""
    if kind.__name__ == "KeyedString":
        return kind(key=text.partition(" ")[0][-1], value=text)
    return kind(data=text)


def _heard(topic: str, message: Any) -> None:
    text = message.value if type(message).__name__ == "KeyedString" else message.data
    _say("heard", topic, text.partition(" ")[0], len(text))


def _say(*words: object) -> None:
    with _saying:
        print(*words, flush=True)


class Stock(Participant):
    """A node with rclpy."""

    def __init__(self, domain: int, name: str) -> None:
        super().__init__()
        import rclpy  # noqa: PLC0415 -- the other programs need none

        self._numbers = count(100)
        self._clients: dict[str, Any] = {}
        rclpy.init(domain_id=domain)
        self._node = rclpy.create_node(name)
        self._node.declare_parameter("rate", 5)
        threading.Thread(target=rclpy.spin, args=(self._node,), daemon=True).start()

    def write(self, topic: str, qos: dict[str, float]) -> None:
        self._writers[topic] = self._node.create_publisher(self._kind(qos), topic, self._profile(qos))

    def read(self, topic: str, qos: dict[str, float]) -> None:
        from rclpy.event_handler import SubscriptionEventCallbacks  # noqa: PLC0415

        def liveliness(status: Any) -> None:
            if status.not_alive_count:
                _say("event", topic, "not_alive")

        events = SubscriptionEventCallbacks(
            deadline=lambda _: _say("event", topic, "deadline"),
            liveliness=liveliness,
            incompatible_qos=lambda status: _say("event", topic, "incompatible", status.last_policy_kind),
        )
        self._readers[topic] = self._node.create_subscription(
            self._kind(qos), topic, lambda message: _heard(topic, message), self._profile(qos), event_callbacks=events
        )

    def publish(self, topic: str, text: str) -> None:
        writer = self._writers[topic]
        writer.publish(_filled(writer.msg_type, text))

    def serve(self, service: str, _: str) -> None:
        from std_srvs.srv import SetBool  # noqa: PLC0415

        def answer(request: Any, response: Any) -> Any:
            response.success, response.message = request.data, "done"
            return response

        self._node.create_service(SetBool, service, answer)

    def call(self, service: str, _: str) -> None:
        from std_srvs.srv import SetBool  # noqa: PLC0415

        client = self._clients.get(service) or self._node.create_client(SetBool, service)
        self._clients[service] = client
        if client.service_is_ready():
            future = client.call_async(SetBool.Request(data=True))
            future.add_done_callback(lambda done: _say("answered", service, done.result().message))

    def set(self, node: str) -> None:
        from rclpy.parameter import Parameter  # noqa: PLC0415
        from rclpy.parameter_client import AsyncParameterClient  # noqa: PLC0415

        client = self._clients.get(node) or AsyncParameterClient(self._node, node)
        self._clients[node] = client
        number = next(self._numbers)

        def read(done: Any) -> None:
            if [value.integer_value for value in done.result().values] == [number]:
                _say("answered", node)

        def was_set(done: Any) -> None:
            if done.result().results[0].successful:
                client.get_parameters(["rate"], read)

        if client.services_are_ready():
            client.set_parameters([Parameter("rate", value=number)], was_set)

    def tick(self, second: str) -> None:
        from rosgraph_msgs.msg import Clock  # noqa: PLC0415

        if "/clock" not in self._writers:
            self._writers["/clock"] = self._node.create_publisher(Clock, "/clock", self._profile({}))
        message = Clock()
        message.clock.sec = int(second)
        self._writers["/clock"].publish(message)

    def watch(self) -> None:
        from rosgraph_msgs.msg import Clock  # noqa: PLC0415

        def heard(message: Any) -> None:
            _say("heard", "/clock", f"m{message.clock.sec}", 0)

        self._node.create_subscription(Clock, "/clock", heard, self._profile({"best_effort": 1}))

    def _kind(self, qos: dict[str, float]) -> Any:
        if "keyed" in qos:
            from test_msgs.msg import KeyedString  # noqa: PLC0415

            return KeyedString
        from std_msgs.msg import String  # noqa: PLC0415

        return String

    def _profile(self, qos: dict[str, float]) -> Any:
        from rclpy import qos as policies  # noqa: PLC0415
        from rclpy.duration import Duration  # noqa: PLC0415

        profile = policies.QoSProfile(depth=int(qos.get("depth", 10)))
        if "best_effort" in qos:
            profile.reliability = policies.ReliabilityPolicy.BEST_EFFORT
        if "latched" in qos:
            profile.durability = policies.DurabilityPolicy.TRANSIENT_LOCAL
        if "deadline" in qos:
            profile.deadline = Duration(seconds=qos["deadline"])
        if "lifespan" in qos:
            profile.lifespan = Duration(seconds=qos["lifespan"])
        if "lease" in qos:
            profile.liveliness = policies.LivelinessPolicy.MANUAL_BY_TOPIC
            profile.liveliness_lease_duration = Duration(seconds=qos["lease"])
        return profile


class Cyclone(Participant):
    """A participant of Cyclone DDS."""

    def __init__(self, domain: int) -> None:
        super().__init__()
        os.environ["CYCLONEDDS_URI"] = (
            "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='lo' multicast='true'/></Interfaces>"
            "</General></Domain></CycloneDDS>"
        )
        import cyclonedds.domain  # noqa: PLC0415

        self._participant: Any = cyclonedds.domain.DomainParticipant(domain)
        threading.Thread(target=self._poll, daemon=True).start()

    def write(self, topic: str, qos: dict[str, float]) -> None:
        from cyclonedds.pub import DataWriter  # noqa: PLC0415

        self._writers[topic] = DataWriter(self._participant, self._topic(topic, qos), _cyclone_qos(qos))

    def read(self, topic: str, qos: dict[str, float]) -> None:
        from cyclonedds.core import Listener  # noqa: PLC0415
        from cyclonedds.sub import DataReader  # noqa: PLC0415

        class Events(Listener):  # type: ignore[misc]
            def on_requested_deadline_missed(self, *_: object) -> None:
                _say("event", topic, "deadline")

            def on_liveliness_changed(self, _: object, status: Any) -> None:
                if status.not_alive_count:
                    _say("event", topic, "not_alive")

            def on_requested_incompatible_qos(self, _: object, status: Any) -> None:
                _say("event", topic, "incompatible", status.last_policy_id)

        reader = DataReader(self._participant, self._topic(topic, qos), _cyclone_qos(qos), listener=Events())
        self._readers = {**self._readers, topic: reader}  # which another thread walks through

    def publish(self, topic: str, text: str) -> None:
        writer = self._writers[topic]
        writer.write(_filled(writer.data_type, text))

    def _topic(self, name: str, qos: dict[str, float]) -> Any:
        from cyclonedds.idl import make_idl_struct  # noqa: PLC0415
        from cyclonedds.topic import Topic  # noqa: PLC0415

        package, kind, fields = "std_msgs", "String", ["data"]
        if "keyed" in qos:
            package, kind, fields = "test_msgs", "KeyedString", ["key", "value"]
        marks = {fields[0]: {"key": True}} if {"key", "keyed"} & {*qos} else {}
        name_of_type = f"{package}::msg::dds_::{kind}_"
        made = make_idl_struct(kind, name_of_type, dict.fromkeys(fields, str), field_annotations=marks)
        return Topic(self._participant, f"rt{name}", made)

    def _poll(self) -> None:
        while True:
            for topic, reader in self._readers.items():
                for each in reader.take(_MOST):
                    if each.sample_info.valid_data:
                        _heard(topic, each)
            time.sleep(_EVERY)


def _cyclone_qos(qos: dict[str, float]) -> Any:
    from cyclonedds.core import Policy, Qos  # noqa: PLC0415
    from cyclonedds.util import duration  # noqa: PLC0415

    def seconds(policy: str) -> Any:
        return duration(seconds=qos[policy])

    kept = Policy.History.KeepLast(int(qos.get("depth", 10)))
    policies = [Policy.DataRepresentation(use_cdrv0_representation=True), kept]
    reliable = Policy.Reliability.Reliable(duration(seconds=10))
    policies.append(Policy.Reliability.BestEffort if "best_effort" in qos else reliable)
    if "latched" in qos:
        policies += [Policy.Durability.TransientLocal, Policy.DurabilityService(0, kept, _MOST, 1, _MOST)]
    if "deadline" in qos:
        policies.append(Policy.Deadline(seconds("deadline")))
    if "lifespan" in qos:
        policies.append(Policy.Lifespan(seconds("lifespan")))
    if "lease" in qos:
        policies.append(Policy.Liveliness.ManualByTopic(seconds("lease")))
    return Qos(*policies)


class Rosbridge(Participant):
    """A client of rosbridge-server-rs, which is a node that this process starts."""

    def __init__(self, domain: int) -> None:
        super().__init__()
        from websockets.sync.client import connect  # noqa: PLC0415

        self._numbers = count(100)
        port = 9090 + domain
        self._folder = tempfile.TemporaryDirectory(prefix="rsb-bench-")
        # It ends with this process, even if that is killed.
        folder = Path(self._folder.name)
        command = ["setpriv", "--pdeathsig", "KILL", _executable(folder)]
        command += ["--no-rosapi", "--bind", f"127.0.0.1:{port}"]
        environ = {"ROS_DOMAIN_ID": str(domain), "HOME": str(folder), **_for_native(folder)}
        self._server = subprocess.Popen(command, env=os.environ | environ, stdout=subprocess.DEVNULL)
        while True:
            try:
                self._socket: Any = connect(f"ws://127.0.0.1:{port}", max_size=None)
                break
            except OSError:
                if self._server.poll() is not None:
                    sys.exit("rosbridge-server-rs has ended")
                time.sleep(0.1)
        threading.Thread(target=self._take, daemon=True).start()

    def write(self, topic: str, qos: dict[str, float]) -> None:
        self._tell("advertise", topic=topic, type="std_msgs/msg/String", qos=_rosbridge_qos(qos))

    def read(self, topic: str, qos: dict[str, float]) -> None:
        self._tell("subscribe", topic=topic, type="std_msgs/msg/String", qos=_rosbridge_qos(qos))

    def publish(self, topic: str, text: str) -> None:
        self._tell("publish", topic=topic, msg={"data": text})

    def serve(self, service: str, _: str) -> None:
        self._tell("advertise_service", service=service, type="std_srvs/srv/SetBool")

    def call(self, service: str, _: str) -> None:
        self._tell("call_service", service=service, type="std_srvs/srv/SetBool", args={"data": True}, id="call")

    def set(self, node: str) -> None:
        number = next(self._numbers)
        parameter = {"name": "rate", "value": {"type": 2, "integer_value": number}}
        kind, service = "rcl_interfaces/srv/SetParameters", f"{node}/set_parameters"
        self._tell("call_service", service=service, type=kind, args={"parameters": [parameter]}, id=str(number))

    def tick(self, second: str) -> None:
        self._tell("advertise", topic="/clock", type="rosgraph_msgs/msg/Clock")
        self._tell("publish", topic="/clock", msg={"clock": {"sec": int(second), "nanosec": 0}})

    def _tell(self, order: str, **what: Any) -> None:
        self._socket.send(json.dumps({"op": order, **what}))

    def _take(self) -> None:
        for each in self._socket:
            said = json.loads(each)
            match said:
                case {"op": "publish"}:
                    _heard(said["topic"], SimpleNamespace(**said["msg"]))
                case {"op": "call_service"}:
                    values = {"success": said["args"]["data"], "message": "done"}
                    whose = {"service": said["service"], "id": said["id"]}
                    self._tell("service_response", **whose, values=values, result=True)
                case {"op": "service_response", "result": True}:
                    self._answered(said["service"], said["id"], said["values"])

    def _answered(self, service: str, number: str, values: Any) -> None:
        node, _, name = service.rpartition("/")
        if name == "set_parameters":
            kind = "rcl_interfaces/srv/GetParameters"
            asked = {"service": f"{node}/get_parameters", "type": kind, "args": {"names": ["rate"]}}
            self._tell("call_service", **asked, id=number)
        elif name == "get_parameters":
            if [str(each["integer_value"]) for each in values["values"]] == [number]:
                _say("answered", node)
        else:
            _say("answered", service, values["message"])


def _rosbridge_qos(qos: dict[str, float]) -> dict[str, Any]:
    policies: dict[str, Any] = {"history": "keep_last", "depth": int(qos.get("depth", 10))}
    policies["reliability"] = "best_effort" if "best_effort" in qos else "reliable"
    policies["durability"] = "transient_local" if "latched" in qos else "volatile"
    for name in {"deadline", "lifespan"} & qos.keys():  # there is no liveliness
        policies[name] = {"secs": int(qos[name]), "nsecs": int(qos[name] % 1 * 1e9)}
    return policies


def _executable(folder: Path) -> str:
    """Return a copy of the server: pip leaves its file not executable."""
    package = importlib.util.find_spec("rosbridge_server_rs")
    assert package is not None
    assert package.origin is not None
    program = Path(package.origin).with_name(f"rosbridge_server_rs_{os.environ.get('ROS_DISTRO', 'jazzy')}")
    copy = Path(shutil.copy(program, folder))
    copy.chmod(0o700)
    return str(copy)


def _for_native(folder: Path) -> dict[str, str]:
    """Return what a program that is not Python needs with ROS's wheels, and nothing with a sourced ROS.

    Wheels lack librmw_implementation.so, which hands all on to a middleware. Their libraries take names of Python's,
    and others that pip has put into folders of their own.
    """
    libraries = Path(sys.prefix, "lib")
    if not (libraries / "librcl.so").exists():
        return {}
    (folder / "librmw_implementation.so").symlink_to(libraries / "librmw_fastrtps_cpp.so")
    others = {str(each.parent) for each in libraries.rglob("*.so*") if each.parent.name.endswith(".libs")}
    return {
        "LD_LIBRARY_PATH": ":".join([str(folder), str(libraries), *sorted(others)]),
        "LD_PRELOAD": str(Path(sysconfig.get_config_var("LIBDIR"), sysconfig.get_config_var("INSTSONAME"))),
        "AMENT_PREFIX_PATH": sys.prefix,
    }


def main() -> None:
    part, domain, name = sys.argv[1:]
    match part:
        case "stock":
            Stock(int(domain), name).run()
        case "cyclone":
            Cyclone(int(domain)).run()
        case "rosbridge":
            Rosbridge(int(domain)).run()
        case "other":
            for each in _OF_WHEELS:  # each distribution has its own libraries
                os.environ.pop(each, None)
            _become(os.environ["OTHER_PYTHON"], "-m", "bench.dds_ends", "stock", domain, name)
        case "server":
            _become("fast-discovery-server", "-i", "0", "-l", "127.0.0.1", "-p", domain)
        case program:
            _become(str(PROGRAMS / program), domain)


def _become(program: str, *arguments: str) -> None:
    """Run another program in this process, so that a signal reaches it."""
    os.dup2(sys.stdout.fileno(), 1)  # Python's may be another file (`rsb_console.child`)
    os.execvp(program, [program, *arguments])


if __name__ == "__main__":
    main()
