"""Messages and services of ROS 2 as CycloneDDS needs them, field by field as their packages define them.

Requests and responses are those of rmw_cyclonedds: who asks and which question it is come first.
"""

from cyclonedds.idl import make_idl_struct
from cyclonedds.idl.types import array, float64, int32, int64, sequence, uint8, uint32, uint64


def _message(name, part="msg", /, **fields):
    """The type of a message, by its ROS name `package/Type`; its fields keep their order."""
    package, kind = name.split("/")
    return make_idl_struct(kind, f"{package}::{part}::dds_::{kind}_", fields)


def _service(name, request, response):
    """The types of a request and its response, by the ROS name of their service."""
    ends = {"Request": request, "Response": response}
    return [_message(f"{name}_{end}", "srv", client=uint64, number=int64, **fields) for end, fields in ends.items()]


Time = _message("builtin_interfaces/Time", sec=int32, nanosec=uint32)
Header = _message("std_msgs/Header", stamp=Time, frame_id=str)
JointState = _message("sensor_msgs/JointState",
    header=Header, name=sequence[str], position=sequence[float64], velocity=sequence[float64],
    effort=sequence[float64],
)
PointField = _message("sensor_msgs/PointField", name=str, offset=uint32, datatype=uint8, count=uint32)
PointCloud2 = _message("sensor_msgs/PointCloud2",
    header=Header, height=uint32, width=uint32, fields=sequence[PointField], is_bigendian=bool, point_step=uint32,
    row_step=uint32, data=sequence[uint8], is_dense=bool,
)
String = _message("std_msgs/String", data=str)
Bool = _message("std_msgs/Bool", data=bool)
KeyValue = _message("diagnostic_msgs/KeyValue", key=str, value=str)
DiagnosticStatus = _message("diagnostic_msgs/DiagnosticStatus",
    level=uint8, name=str, message=str, hardware_id=str, values=sequence[KeyValue],
)
DiagnosticArray = _message("diagnostic_msgs/DiagnosticArray", header=Header, status=sequence[DiagnosticStatus])
Vector3 = _message("geometry_msgs/Vector3", x=float64, y=float64, z=float64)
Wrench = _message("geometry_msgs/Wrench", force=Vector3, torque=Vector3)
WrenchStamped = _message("geometry_msgs/WrenchStamped", header=Header, wrench=Wrench)
InterfaceValue = _message("control_msgs/InterfaceValue", interface_names=sequence[str], values=sequence[float64])
DynamicJointState = _message("control_msgs/DynamicJointState",
    header=Header, joint_names=sequence[str], interface_values=sequence[InterfaceValue],
)
Clock = _message("rosgraph_msgs/Clock", clock=Time)
JointTrajectoryPoint = _message("trajectory_msgs/JointTrajectoryPoint",
    positions=sequence[float64], velocities=sequence[float64], accelerations=sequence[float64],
    effort=sequence[float64], time_from_start=Time,  # a Duration, which is laid out alike
)
JointTrajectory = _message("trajectory_msgs/JointTrajectory",
    header=Header, joint_names=sequence[str], points=sequence[JointTrajectoryPoint],
)
ParameterValue = _message("rcl_interfaces/ParameterValue",
    type=uint8, bool_value=bool, integer_value=int64, double_value=float64, string_value=str,
    byte_array_value=sequence[uint8], bool_array_value=sequence[bool], integer_array_value=sequence[int64],
    double_array_value=sequence[float64], string_array_value=sequence[str],
)
ListParametersResult = _message("rcl_interfaces/ListParametersResult", names=sequence[str], prefixes=sequence[str])
FloatingPointRange = _message("rcl_interfaces/FloatingPointRange", from_value=float64, to_value=float64, step=float64)
IntegerRange = _message("rcl_interfaces/IntegerRange", from_value=int64, to_value=int64, step=uint64)
ParameterDescriptor = _message("rcl_interfaces/ParameterDescriptor",
    name=str, type=uint8, description=str, additional_constraints=str, read_only=bool, dynamic_typing=bool,
    floating_point_range=sequence[FloatingPointRange], integer_range=sequence[IntegerRange],
)
Parameter = _message("rcl_interfaces/Parameter", name=str, value=ParameterValue)
SetParametersResult = _message("rcl_interfaces/SetParametersResult", successful=bool, reason=str)
Gid = _message("rmw_dds_common/Gid", data=array[uint8, 16])
NodeEntitiesInfo = _message("rmw_dds_common/NodeEntitiesInfo",
    node_namespace=str, node_name=str, reader_gid_seq=sequence[Gid], writer_gid_seq=sequence[Gid],
)
ParticipantEntitiesInfo = _message("rmw_dds_common/ParticipantEntitiesInfo",
    gid=Gid, node_entities_info_seq=sequence[NodeEntitiesInfo],
)
TriggerRequest, TriggerResponse = _service("std_srvs/Trigger", {"nothing": uint8}, {"success": bool, "message": str})
AskRequest, AskResponse = _service("palpate_ros/AskTrajectory",
    {"trajectory": JointTrajectory, "level": float64},
    {
        "success": bool, "message": str, "predicted": JointTrajectory, "half_width": JointTrajectory, "level": float64,
        "peak": float64, "peak_with_band": float64, "contacts": sequence[uint32], "known": sequence[uint32],
        "goes_on": bool,
    },
)
NamesRequest, ValuesResponse = _service("rcl_interfaces/GetParameters",
    {"names": sequence[str]}, {"values": sequence[ParameterValue]},
)
ListRequest, ListResponse = _service("rcl_interfaces/ListParameters",
    {"prefixes": sequence[str], "depth": uint64}, {"result": ListParametersResult},
)
TypesRequest, TypesResponse = _service("rcl_interfaces/GetParameterTypes",
    {"names": sequence[str]}, {"types": sequence[uint8]},
)
DescribeRequest, DescribeResponse = _service("rcl_interfaces/DescribeParameters",
    {"names": sequence[str]}, {"descriptors": sequence[ParameterDescriptor]},
)
SetRequest, SetResponse = _service("rcl_interfaces/SetParameters",
    {"parameters": sequence[Parameter]}, {"results": sequence[SetParametersResult]},
)
SetAllRequest, SetAllResponse = _service("rcl_interfaces/SetParametersAtomically",
    {"parameters": sequence[Parameter]}, {"result": SetParametersResult},
)
