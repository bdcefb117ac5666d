//! ROS definitions of the messages that are written.

use super::sink::TopicDefinition;

macro_rules! separator {
    () => {
        "================================================================================\n"
    };
}

macro_rules! header {
    (ros1) => {
        concat!(separator!(), "MSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n")
    };
    (ros2) => {
        concat!(
            separator!(),
            "MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n",
            separator!(),
            "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
        )
    };
}

macro_rules! image {
    ($ros:ident) => {
        concat!(
            "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\n",
            "uint8[] data\n",
            header!($ros)
        )
    };
}

macro_rules! imu {
    ($ros:ident) => {
        concat!(
            "std_msgs/Header header\ngeometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n",
            "geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n",
            "geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance\n",
            header!($ros),
            separator!(),
            "MSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
            separator!(),
            "MSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n"
        )
    };
}

/// Events, frames and IMU samples of ROS 1, with the topic names of rpg_dvs_ros.
pub const ROS1: [TopicDefinition; 3] = [
    TopicDefinition {
        name: "/dvs/events",
        type_name: "dvs_msgs/EventArray",
        definition: concat!(
            "std_msgs/Header header\nuint32 height\nuint32 width\ndvs_msgs/Event[] events\n",
            header!(ros1),
            separator!(),
            "MSG: dvs_msgs/Event\nuint16 x\nuint16 y\ntime ts\nbool polarity\n"
        ),
        md5: "5e8beee5a6c107e504c2e78903c224b8",
    },
    TopicDefinition {
        name: "/dvs/image_raw",
        type_name: "sensor_msgs/Image",
        definition: image!(ros1),
        md5: "060021388200f6f0f447d0fcd9c64743",
    },
    TopicDefinition {
        name: "/dvs/imu",
        type_name: "sensor_msgs/Imu",
        definition: imu!(ros1),
        md5: "6a62c6daae103f4ff57a132d6f95cec2",
    },
];

/// Events, frames and IMU samples of ROS 2, with the topic names of libcaer_driver.
pub const ROS2: [TopicDefinition; 3] = [
    TopicDefinition {
        name: "/event_camera/events",
        type_name: "event_camera_msgs/msg/EventPacket",
        definition: concat!(
            "std_msgs/Header header\nuint32 height\nuint32 width\nuint64 seq\nuint64 time_base\nstring encoding\n",
            "bool is_bigendian\nuint8[] events\n",
            header!(ros2)
        ),
        md5: "",
    },
    TopicDefinition {
        name: "/event_camera/image_raw",
        type_name: "sensor_msgs/msg/Image",
        definition: image!(ros2),
        md5: "",
    },
    TopicDefinition { name: "/event_camera/imu", type_name: "sensor_msgs/msg/Imu", definition: imu!(ros2), md5: "" },
];
