//! Poses with their standard deviations as a table.

use std::io::{self, Write};

use super::UncertainPose;
use evcal_geometry::timed_pose::TimedPose;

/// Writes `poses`, one per line after a line with the names of the columns; fields of an unknown σ are empty.
pub fn write(mut writer: impl Write, poses: &[UncertainPose]) -> io::Result<()> {
    writeln!(writer, "t,tx,ty,tz,qx,qy,qz,qw,sigma_tx,sigma_ty,sigma_tz,sigma_rx,sigma_ry,sigma_rz")?;
    for UncertainPose { pose: TimedPose { t, pose }, sigma } in poses {
        write!(writer, "{t:.6}")?;
        for value in pose.translation.vector.iter() {
            write!(writer, ",{value:.9}")?;
        }
        for value in pose.rotation.coords.iter() {
            write!(writer, ",{value:.12}")?;
        }
        match sigma {
            Some(sigma) => {
                for value in sigma.position.iter().chain(&sigma.rotation) {
                    write!(writer, ",{value:.3e}")?;
                }
            }
            None => write!(writer, ",,,,,,")?,
        }
        writeln!(writer)?;
    }
    Ok(())
}
