//! Images of a frame camera, which sends no events: all of one size, in order of time.

use std::path::Path;

use evcal_core::sensor::Sensor;
use evcal_files::remedies;

use super::image_folder::{ImageFolder, ImageFolderError, Stamps};
use super::pictures::TimedImage;
use super::ros::ImageTopic;
use crate::error::RecordingError;
use crate::files::Files;
use crate::formats::folder_format;
use crate::options::Damage;

/// Location of the images.
#[derive(Clone, Debug)]
enum Source {
    /// A folder.
    Folder(ImageFolder),
    /// A topic of a bag.
    Topic(ImageTopic),
}

/// Images of one camera.
#[derive(Clone, Debug)]
pub struct Images {
    source: Source,
    files: Files,
    stamps: Stamps,
}

/// Error while reading images.
#[derive(Debug, thiserror::Error)]
pub enum ImagesError {
    /// The folder cannot be read.
    #[error("{0}")]
    Folder(#[from] ImageFolderError),
    /// The bag cannot be read.
    #[error("{0}")]
    Topic(#[from] RecordingError),
}

remedies! { ImagesError, say;
    Self::Topic(error) => error.remedy(say);
}

impl Images {
    /// Opens the images at `path`: a folder of images, the `topic` of a bag, or the only image topic of a bag without
    /// events. `stamps` is the moment of the exposure that the timestamps refer to. `None` if `path` contains events
    /// instead.
    ///
    /// # Errors
    /// [`ImagesError`] names the file and the fault.
    pub fn open(path: &Path, topic: Option<&str>, damage: Damage, stamps: Stamps) -> Result<Option<Self>, ImagesError> {
        let source = if path.is_dir() && folder_format(path).is_none() {
            Some(Source::Folder(ImageFolder::open(path, stamps)?))
        } else {
            ImageTopic::open(path, topic, damage)?.map(Source::Topic)
        };
        Ok(source.map(|source| {
            let files = match &source {
                Source::Folder(folder) => Files::new(folder.files()),
                Source::Topic(topic) => Files::new(topic.files()),
            };
            Self { source, files, stamps }
        }))
    }

    /// As [`Images::open`], but timestamps do not matter: a folder without a table yields its images in the order of their names.
    ///
    /// # Errors
    /// [`ImagesError`] names the file and the fault.
    pub fn open_views(path: &Path, topic: Option<&str>, damage: Damage) -> Result<Option<Self>, ImagesError> {
        if path.is_dir() && folder_format(path).is_none() && !ImageFolder::has_table(path) {
            let folder = ImageFolder::by_name(path)?;
            let files = Files::new(folder.files());
            return Ok(Some(Self { source: Source::Folder(folder), files, stamps: Stamps::default() }));
        }
        Self::open(path, topic, damage, Stamps::default())
    }

    /// Name for messages: the path of the folder, or the bag and its topic.
    pub fn name(&self) -> String {
        match &self.source {
            Source::Folder(folder) => folder.path().display().to_string(),
            Source::Topic(topic) => topic.name(),
        }
    }

    /// Path of the folder or bag.
    pub fn path(&self) -> &Path {
        match &self.source {
            Source::Folder(folder) => folder.path(),
            Source::Topic(topic) => topic.path(),
        }
    }

    /// Returns all files that are read.
    pub fn source_files(&self) -> &Files {
        &self.files
    }

    /// Width and height of the images in pixels.
    pub fn sensor(&self) -> Sensor {
        match &self.source {
            Source::Folder(folder) => folder.sensor(),
            Source::Topic(topic) => topic.sensor(),
        }
    }

    /// Moment of the exposure that the timestamps refer to.
    pub fn stamps(&self) -> Stamps {
        self.stamps
    }

    /// `true` if the exposure times are known.
    pub fn exposure_known(&self) -> bool {
        match &self.source {
            Source::Folder(folder) => folder.exposure_known(),
            // An image message of ROS has a single timestamp.
            Source::Topic(_) => false,
        }
    }

    /// Passes the images to `visit`, in order of time, with times in µs. Returns a sentence if something was lost.
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
