//! The images of a camera that sends no events, of one size and in the order of time.

use std::path::Path;

use evcal_core::sensor::Sensor;

use super::image_folder::{ImageFolder, ImageFolderError, Stamps};
use super::pictures::TimedImage;
use super::ros::ImageTopic;
use crate::error::RecordingError;
use crate::formats::folder_format;
use crate::options::Damage;

/// Where images are.
#[derive(Clone, Debug)]
enum Source {
    /// In a folder.
    Folder(ImageFolder),
    /// In a topic of a bag.
    Topic(ImageTopic),
}

/// Images of one camera.
#[derive(Clone, Debug)]
pub struct Images {
    source: Source,
    stamps: Stamps,
}

/// Why images cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum ImagesError {
    /// Those of a folder.
    #[error("{0}")]
    Folder(#[from] ImageFolderError),
    /// Those of a bag.
    #[error("{0}")]
    Topic(#[from] RecordingError),
}

impl Images {
    /// Opens the folder of images at `path`, or its `topic` where it is a bag, or the only topic of images of a bag without events. Time stamps are those of `stamps` of the exposures. `None` where `path` holds events instead.
    ///
    /// # Errors
    /// [`ImagesError`] names the file and what is wrong with it.
    pub fn open(path: &Path, topic: Option<&str>, damage: Damage, stamps: Stamps) -> Result<Option<Self>, ImagesError> {
        let source = if path.is_dir() && folder_format(path).is_none() {
            Some(Source::Folder(ImageFolder::open(path, stamps)?))
        } else {
            ImageTopic::open(path, topic, damage)?.map(Source::Topic)
        };
        Ok(source.map(|source| Self { source, stamps }))
    }

    /// The folder, or the bag and its topic.
    pub fn name(&self) -> String {
        match &self.source {
            Source::Folder(folder) => folder.path().display().to_string(),
            Source::Topic(topic) => topic.name(),
        }
    }

    /// The folder, or the bag.
    pub fn path(&self) -> &Path {
        match &self.source {
            Source::Folder(folder) => folder.path(),
            Source::Topic(topic) => topic.path(),
        }
    }

    /// Width and height of the images.
    pub fn sensor(&self) -> Sensor {
        match &self.source {
            Source::Folder(folder) => folder.sensor(),
            Source::Topic(topic) => topic.sensor(),
        }
    }

    /// What the time stamps stand for.
    pub fn stamps(&self) -> Stamps {
        self.stamps
    }

    /// Whether it is known how long the images were exposed.
    pub fn exposure_known(&self) -> bool {
        match &self.source {
            Source::Folder(folder) => folder.exposure_known(),
            // An image of ROS has one time.
            Source::Topic(_) => false,
        }
    }

    /// Hands the images to `visit`, in the order of time, times in µs. What was lost is returned in a sentence.
    ///
    /// # Errors
    /// [`ImagesError`] names the image that cannot be used.
    pub fn visit(&self, visit: impl FnMut(TimedImage)) -> Result<Option<String>, ImagesError> {
        match &self.source {
            Source::Folder(folder) => Ok(folder.visit(visit).map(|()| None)?),
            Source::Topic(topic) => Ok(topic.visit(visit)?),
        }
    }
}
