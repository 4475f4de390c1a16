//! A folder that appears under its name only when everything is in it.

use super::SimulatedSession;
use crate::WorldError;
use evermap_recording::{finish_folder, unfinished_folder};
use serde_json::Value;
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// A folder being filled. It is gone with what fills it, unless it was finished by then.
pub struct Folder {
    /// Of a name that nobody else has.
    part: TempDir,
    done: PathBuf,
}

impl Folder {
    /// Starts the folder `name` in `out`; an older one stays until this one is finished.
    pub fn create(out: &Path, name: &str) -> Result<Self, WorldError> {
        let done = out.join(name);
        let part = unfinished_folder(out).map_err(|error| WorldError::io(&done, error))?;
        Ok(Self { part, done })
    }

    /// Where it is filled.
    pub fn path(&self) -> &Path {
        self.part.path()
    }

    /// Writes a file in it, and the folder that the file is in.
    pub fn save(&self, name: &str, bytes: &[u8]) -> Result<(), WorldError> {
        let path = self.path().join(name);
        if let Some(parent) = path.parent() {
            fs::create_dir_all(parent).map_err(|error| WorldError::io(parent, error))?;
        }
        fs::write(&path, bytes).map_err(|error| WorldError::io(&path, error))
    }

    /// Writes JSON, to be read by people too.
    pub fn save_json(&self, name: &str, value: &Value) -> Result<(), WorldError> {
        self.save(name, format!("{value:#}\n").as_bytes())
    }

    /// Writes where a session's vehicle was, a line for each stamp (ns): `stamp_s x y z qx qy qz qw`.
    pub fn save_poses(
        &self,
        name: &str,
        session: &SimulatedSession,
        stamps: impl Iterator<Item = u64>,
    ) -> Result<(), WorldError> {
        let mut text = String::from("# stamp_s x y z qx qy qz qw (map_from_vehicle)\n");
        for stamp in stamps {
            let (s, ns) = (stamp / 1_000_000_000, stamp % 1_000_000_000);
            let _ = write!(text, "{s}.{ns:09}");
            for value in session.map_from_vehicle(stamp).to_array() {
                let _ = write!(text, " {value:.9}");
            }
            text.push('\n');
        }
        self.save(name, text.as_bytes())
    }

    /// Gives it its name, in place of an older one.
    pub fn finish(self) -> Result<PathBuf, WorldError> {
        remove(&self.done)?;
        let finished = finish_folder(self.part, &self.done);
        finished.map_err(|error| WorldError::io(&self.done, error))?;
        Ok(self.done)
    }
}

fn remove(folder: &Path) -> Result<(), WorldError> {
    if folder.exists() {
        fs::remove_dir_all(folder).map_err(|error| WorldError::io(folder, error))?;
    }
    Ok(())
}
