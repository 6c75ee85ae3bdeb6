"""The nodes of a graph as data: one table, for `ros2 launch`, for our supervisor and for the tests."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field


@dataclass(frozen=True)
class NodeSpec:
    """One node of a graph."""

    package: str
    """The ROS package that it is installed in."""
    executable: str
    """An installed executable, or the full name of a module of the package, which only our supervisor runs."""
    name: str = ""
    """The node's name; empty: that of the executable."""
    parameters: Mapping[str, object] = field(default_factory=dict)
    """Values by parameter."""
    remappings: Sequence[tuple[str, str]] = ()
    """Topics as (before, after)."""
    namespace: str = ""
    """As /lab; empty: none."""
    params_file: str = ""
    """YAML file of ROS parameters, which come before `parameters`; empty: none."""
    nice: int = 0
    """Priority given up to others on the same cores, 0 (none) to 19."""
    realtime: int = 0
    """Priority of first-in-first-out scheduling, 1 to 90, where the system permits it; 0: none."""
    is_required: bool = False
    """Whether `ros2 launch` ends all others where this one ends."""

    def __post_init__(self):
        if not self.name:
            object.__setattr__(self, "name", self.executable)


@dataclass(frozen=True)
class LaunchArgument:
    """A launch argument."""

    name: str
    """As on the command line, before `:=`."""
    default: str
    """A string, as on the command line."""
    description: str
    """What it means, a sentence."""


def complete(arguments: Mapping[str, str], known: Sequence[LaunchArgument]) -> dict[str, str]:
    """`arguments` with the defaults of `known` filled in. Raises ValueError for a name that is not known."""
    names = [argument.name for argument in known]
    unknown = sorted(set(arguments) - set(names))
    if unknown:
        raise ValueError(f"launch argument {', '.join(unknown)}: expected one of {', '.join(names)}")
    return {a.name: str(arguments.get(a.name, a.default)) for a in known}


def launch_description(known: Sequence[LaunchArgument], graph: Callable[[Mapping[str, str]], Sequence[NodeSpec]]):
    """A LaunchDescription that declares the arguments and starts the nodes of `graph`; needs launch_ros."""
    from launch import LaunchDescription
    from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
    from launch.substitutions import LaunchConfiguration
    from launch_ros.actions import Node

    def start(context):
        given = {a.name: LaunchConfiguration(a.name).perform(context) for a in known}
        return [
            Node(
                package=spec.package,
                executable=spec.executable,
                name=spec.name,
                namespace=spec.namespace or None,
                output="screen",
                parameters=[dict(spec.parameters), *filter(None, [spec.params_file])],
                remappings=list(spec.remappings),
                prefix=f"nice -n {spec.nice}" if spec.nice else None,
                on_exit=[Shutdown(reason=f"{spec.name} has ended")] if spec.is_required else None,
            )
            for spec in graph(given)
        ]

    declared = [DeclareLaunchArgument(a.name, default_value=a.default, description=a.description) for a in known]
    return LaunchDescription([*declared, OpaqueFunction(function=start)])
