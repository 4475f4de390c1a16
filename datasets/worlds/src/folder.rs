//! A folder that appears under its name only when everything is in it.

use crate::WorldError;
use std::fs;
use std::path::{Path, PathBuf};

/// A folder being filled.
pub struct Folder {
    part: PathBuf,
    done: PathBuf,
}

impl Folder {
    /// Starts the folder `name` in `out`; an older one stays until this one is finished.
    ///
    /// # Errors
    /// When it cannot be created.
    pub fn create(out: &Path, name: &str) -> Result<Self, WorldError> {
        let (part, done) = (out.join(format!("{name}.part")), out.join(name));
        remove(&part)?;
        fs::create_dir_all(&part).map_err(|error| WorldError::io(&part, error))?;
        Ok(Self { part, done })
    }

    /// Where it is filled.
    pub fn path(&self) -> &Path {
        &self.part
    }

    /// Writes a file in it, and the folder that the file is in.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn save(&self, name: &str, bytes: &[u8]) -> Result<(), WorldError> {
        let path = self.part.join(name);
        if let Some(parent) = path.parent() {
            fs::create_dir_all(parent).map_err(|error| WorldError::io(parent, error))?;
        }
        fs::write(&path, bytes).map_err(|error| WorldError::io(&path, error))
    }

    /// Gives it its name, in place of an older one.
    ///
    /// # Errors
    /// When it cannot be renamed.
    pub fn finish(self) -> Result<PathBuf, WorldError> {
        remove(&self.done)?;
        fs::rename(&self.part, &self.done).map_err(|error| WorldError::io(&self.done, error))?;
        Ok(self.done)
    }
}

fn remove(folder: &Path) -> Result<(), WorldError> {
    if folder.exists() {
        fs::remove_dir_all(folder).map_err(|error| WorldError::io(folder, error))?;
    }
    Ok(())
}
