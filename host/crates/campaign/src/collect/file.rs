//! The table of collected contacts, as `identify` takes it: one row each, stored before the next one is recorded.

use std::fmt::Write as _;
use std::fs::{File, OpenOptions};
use std::io::{Read as _, Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};

use super::StillPose;

/// A row of the table.
#[derive(Clone, Debug, PartialEq)]
pub struct ContactRow {
    /// Placement of the plate, from 1.
    pub place: u32,
    /// Id of the sphere.
    pub sphere: u32,
    /// Joint angles, in rad.
    pub q: Vec<f64>,
}

/// Why the table could not be opened or extended.
#[derive(Debug, thiserror::Error)]
pub enum ContactFileError {
    /// The system refused.
    #[error("{path}: {source}; the rows that are in it stay as they are")]
    Io {
        /// File.
        path: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file is another table.
    #[error("{path}: line {line} is not a row of a collected table: give another file with --out, or remove the line")]
    Row {
        /// File.
        path: String,
        /// Line, from 1.
        line: usize,
    },
    /// The file has other columns.
    #[error("{path} has the columns \"{found}\", but this robot gives \"{expected}\": give another file with --out")]
    Columns {
        /// File.
        path: String,
        /// Its columns.
        found: String,
        /// The columns of this robot.
        expected: String,
    },
}

/// A table that only grows.
#[derive(Debug)]
pub struct ContactFile {
    path: PathBuf,
    file: File,
    torques: bool,
    contacts: Vec<ContactRow>,
}

impl ContactFile {
    /// Opens a table to go on with it, or begins one. A row that a power failure left unfinished is removed: it has no
    /// line end, and its pose was not reported as kept.
    ///
    /// # Errors
    /// The file is another table, or cannot be written.
    pub fn open(path: &Path, joints: usize, torques: bool) -> Result<Self, ContactFileError> {
        let io = |source| ContactFileError::Io {
            path: path.display().to_string(),
            source,
        };
        let mut file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(path)
            .map_err(io)?;
        let mut text = String::new();
        file.read_to_string(&mut text).map_err(io)?;
        let header = header(joints, torques);
        let whole = text.rfind('\n').map_or(0, |end| end + 1);
        let mut contacts = Vec::new();
        let mut lines = text[..whole].lines().zip(1..);
        match lines.next() {
            Some((found, _)) if found != header => {
                return Err(ContactFileError::Columns {
                    path: path.display().to_string(),
                    found: spherecal_model::excerpt(found),
                    expected: header,
                });
            }
            None if !text.is_empty() && !header.starts_with(&text) => {
                return Err(ContactFileError::Row {
                    path: path.display().to_string(),
                    line: 1,
                });
            }
            _ => {}
        }
        for (row, line) in lines {
            let contact = parse(row, joints).ok_or_else(|| ContactFileError::Row {
                path: path.display().to_string(),
                line,
            })?;
            contacts.push(contact);
        }
        file.set_len(whole as u64).map_err(io)?;
        file.seek(SeekFrom::End(0)).map_err(io)?;
        let mut table = Self {
            path: path.to_owned(),
            file,
            torques,
            contacts,
        };
        if whole == 0 {
            table.write(&header)?;
        }
        Ok(table)
    }

    /// The contacts in the table.
    pub fn contacts(&self) -> &[ContactRow] {
        &self.contacts
    }

    /// Appends a contact; it is on the disk afterwards.
    ///
    /// # Errors
    /// The system refused to write.
    pub fn append(&mut self, place: u32, sphere: u32, pose: &StillPose) -> Result<(), ContactFileError> {
        let mut row = format!("{place},{sphere}");
        let tau: &[f64] = if self.torques { &pose.tau } else { &[] };
        for q in &pose.q {
            // Writing to a string cannot fail.
            let _ = write!(row, ",{q:.9}");
        }
        for tau in tau {
            let _ = write!(row, ",{tau:.5}");
        }
        self.write(&row)?;
        self.contacts.push(ContactRow {
            place,
            sphere,
            q: pose.q.clone(),
        });
        Ok(())
    }

    fn write(&mut self, row: &str) -> Result<(), ContactFileError> {
        let written = self.file.write_all(format!("{row}\n").as_bytes());
        written
            .and_then(|()| self.file.sync_data())
            .map_err(|source| ContactFileError::Io {
                path: self.path.display().to_string(),
                source,
            })
    }
}

fn header(joints: usize, torques: bool) -> String {
    let mut header = "place,sphere".to_owned();
    for name in ["q", "tau"].iter().take(1 + usize::from(torques)) {
        for j in 1..=joints {
            let _ = write!(header, ",{name}{j}");
        }
    }
    header
}

fn parse(row: &str, joints: usize) -> Option<ContactRow> {
    let mut cells = row.split(',');
    let place = cells.next()?.parse().ok()?;
    let sphere = cells.next()?.parse().ok()?;
    let q: Vec<f64> = cells
        .by_ref()
        .take(joints)
        .map_while(|cell| cell.parse().ok())
        .collect();
    (q.len() == joints).then_some(ContactRow { place, sphere, q })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(q: f64) -> StillPose {
        StillPose {
            q: vec![q; 2],
            tau: vec![1.0; 2],
            spread_rad: 0.0,
            readings: 1,
        }
    }

    // Fails if an opened table loses a row, keeps an unfinished one, or another table is extended.
    #[test]
    fn a_table_goes_on_where_it_stopped() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("contacts.csv");
        let mut table = ContactFile::open(&path, 2, true).expect("a new table");
        table.append(1, 3, &pose(0.25)).expect("a row");
        table.append(1, 2, &pose(-0.5)).expect("a row");
        drop(table);
        let whole = std::fs::read_to_string(&path).expect("a file");
        std::fs::write(&path, format!("{whole}1,2,0.1")).expect("an unfinished row");
        let table = ContactFile::open(&path, 2, true).expect("the same table");
        assert_eq!(table.contacts().len(), 2);
        assert_eq!((table.contacts()[0].sphere, table.contacts()[0].q[1]), (3, 0.25));
        assert_eq!(std::fs::read_to_string(&path).expect("a file"), whole);
        assert!(matches!(
            ContactFile::open(&path, 3, true),
            Err(ContactFileError::Columns { .. })
        ));
        std::fs::write(&path, "notes").expect("a text");
        assert!(matches!(
            ContactFile::open(&path, 2, true),
            Err(ContactFileError::Row { .. })
        ));
        assert_eq!(std::fs::read_to_string(&path).expect("a file"), "notes");
    }
}
