//! Recordings of ROS: bags of ROS 1, and bags of ROS 2 as MCAP or SQLite, either single files or their folder.
//!
//! | message | content that is read |
//! |---|---|
//! | `dvs_msgs/EventArray`, `prophesee_event_msgs/EventArray` | events |
//! | `event_camera_msgs/EventPacket` | events, encodings `evt3`, `libcaer`, `libcaer_cmp`, `mono` |
//! | `sensor_msgs/Image` | frames: `mono8`, `mono16`, `bgr8`, `rgb8`, `bgra8`, `rgba8`, `bayer_rggb8` and other Bayer patterns of 8 and 16 bits |
//! | `sensor_msgs/CompressedImage` | images of a second camera: JPEG and PNG |
//! | `sensor_msgs/Imu` | IMU samples |
//!
//! Times come from the sensor and are stored in the messages. Messages are read in order of their times of recording
//! (`order`).

mod bag;
mod bayer;
mod chunked;
mod container;
mod db3;
mod events;
mod extras;
mod fields;
mod folder;
mod images;
mod mcap;
mod merged_samples;
mod message;
mod order;
mod packet;
mod picture;
mod sqlite;
#[cfg(test)]
mod tests;
mod write;

pub use bag::FORMAT as BAG_FORMAT;
pub use db3::FORMAT as DB3_FORMAT;
pub use folder::{FORMAT as FOLDER_FORMAT, folder_of, is_bag as is_folder};
pub use images::ImageTopic;
pub use mcap::FORMAT as MCAP_FORMAT;
#[cfg(feature = "hdf5")]
pub(super) use message::GRAVITY;
