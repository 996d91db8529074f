//! Unpacks `.tgz` archives of sequences: nothing outside the target, no links, no more than stated limits.

use std::fs::File;
use std::io::{self, Read};
use std::path::{Component, Path, PathBuf};

use flate2::read::GzDecoder;
use tar::{Archive, Entry, EntryType};

use crate::DatasetError;

/// What an archive may unpack to.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Files and folders.
    pub entries: usize,
    /// Bytes of all files together.
    pub bytes: u64,
}

impl Default for Limits {
    /// Far above the benchmark's largest sequence (about 5,000 frames, 3 GB), far below what fills a disk by surprise.
    fn default() -> Self {
        Self { entries: 100_000, bytes: 20 << 30 }
    }
}

/// Unpacks the archive at `path` into the folder `target`.
///
/// # Errors
/// When a file cannot be read or written, the archive is damaged or exceeds `limits`, or an entry is neither file nor folder or
/// points outside `target`. What was unpacked until then stays.
pub fn unpack(path: &Path, target: &Path, limits: Limits) -> Result<(), DatasetError> {
    let file = File::open(path).map_err(DatasetError::io(path))?;
    let mut archive = Archive::new(GzDecoder::new(io::BufReader::new(file)));
    let mut remaining = limits;
    for entry in archive.entries().map_err(DatasetError::io(path))? {
        let mut entry = entry.map_err(DatasetError::io(path))?;
        let name = String::from_utf8_lossy(&entry.path_bytes()).into_owned();
        let refuse = |reason: String| DatasetError::Archive { path: path.to_owned(), entry: name.clone(), reason };
        remaining.take(entry.size()).map_err(|reason| refuse(reason.to_owned()))?;
        let relative = safe_path(Path::new(&name)).ok_or_else(|| refuse("points outside the archive".to_owned()))?;
        write_entry(&mut entry, &target.join(relative)).map_err(|e| refuse(e.to_string()))?;
    }
    Ok(())
}

impl Limits {
    /// Subtracts one entry of `size` bytes.
    fn take(&mut self, size: u64) -> Result<(), &'static str> {
        self.entries = self.entries.checked_sub(1).ok_or("the archive has too many entries")?;
        self.bytes = self.bytes.checked_sub(size).ok_or("the archive unpacks to too many bytes")?;
        Ok(())
    }
}

/// The path without `.` components; `None` when it is absolute or has `..`.
fn safe_path(path: &Path) -> Option<PathBuf> {
    let mut safe = PathBuf::new();
    for component in path.components() {
        match component {
            Component::Normal(part) => safe.push(part),
            Component::CurDir => {}
            Component::ParentDir | Component::RootDir | Component::Prefix(_) => return None,
        }
    }
    Some(safe)
}

fn write_entry<R: Read>(entry: &mut Entry<'_, R>, target: &Path) -> io::Result<()> {
    match entry.header().entry_type() {
        EntryType::Directory => std::fs::create_dir_all(target),
        EntryType::Regular | EntryType::Continuous => {
            if let Some(folder) = target.parent() {
                std::fs::create_dir_all(folder)?;
            }
            io::copy(entry, &mut File::create(target)?).map(drop)
        }
        // Metadata of the archive itself.
        EntryType::XGlobalHeader => Ok(()),
        other => Err(io::Error::other(format!("is a {other:?}: only files and folders are unpacked"))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An archive with one entry; the name is written as raw bytes because the builder refuses unsafe ones.
    fn archive(name: &str, kind: EntryType, content: &[u8]) -> tempfile::NamedTempFile {
        let file = tempfile::NamedTempFile::new().unwrap();
        let encoder = flate2::write::GzEncoder::new(file.reopen().unwrap(), flate2::Compression::fast());
        let mut builder = tar::Builder::new(encoder);
        let mut header = tar::Header::new_gnu();
        header.as_gnu_mut().unwrap().name[..name.len()].copy_from_slice(name.as_bytes());
        header.set_entry_type(kind);
        header.set_mode(0o644);
        header.set_size(content.len() as u64);
        if kind.is_symlink() {
            header.set_link_name("/etc/passwd").unwrap();
        }
        header.set_cksum();
        builder.append(&header, content).unwrap();
        builder.into_inner().unwrap().finish().unwrap();
        file
    }

    #[test]
    fn unpacks_files() {
        let target = tempfile::tempdir().unwrap();
        let file = archive("./a/b.txt", EntryType::Regular, b"hello");
        unpack(file.path(), target.path(), Limits::default()).unwrap();
        assert_eq!(std::fs::read(target.path().join("a/b.txt")).unwrap(), b"hello");
    }

    #[test]
    fn refuses_paths_outside_links_and_excess() {
        let target = tempfile::tempdir().unwrap();
        let reason =
            |file: tempfile::NamedTempFile, limits| unpack(file.path(), target.path(), limits).unwrap_err().to_string();
        let all = Limits::default();
        assert!(reason(archive("../evil", EntryType::Regular, b"x"), all).contains("outside"));
        assert!(reason(archive("/tmp/evil", EntryType::Regular, b"x"), all).contains("outside"));
        assert!(reason(archive("link", EntryType::Symlink, b""), all).contains("Symlink"));
        assert!(reason(archive("link", EntryType::Link, b""), all).contains("only files"));
        assert!(reason(archive("big", EntryType::Regular, b"12345"), Limits { bytes: 4, ..all }).contains("bytes"));
        assert!(reason(archive("one", EntryType::Regular, b""), Limits { entries: 0, ..all }).contains("entries"));
        assert_eq!(std::fs::read_dir(target.path()).unwrap().count(), 0);
    }

    #[test]
    fn a_damaged_archive_is_an_error() {
        let target = tempfile::tempdir().unwrap();
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), b"this is no gzip").unwrap();
        assert!(unpack(file.path(), target.path(), Limits::default()).is_err());
    }
}
