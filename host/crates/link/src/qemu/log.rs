//! Decodes the controller's log from `defmt` frames to text, with the image's own ELF file. Without
//! the feature `qemu-log` the text says that the log was not decoded.

use std::path::Path;

use super::QemuError;

/// Decodes the log that `image` wrote to `raw` into the text file `text`. If the log is missing or
/// was written by another image, the text says so.
///
/// # Errors
/// When a file cannot be read or written.
pub fn decode_file(image: &Path, raw: &Path, text: &Path) -> Result<(), QemuError> {
    let failed = |path: &Path| {
        let path = path.to_path_buf();
        move |source| QemuError::File { path, source }
    };
    let elf = std::fs::read(image).map_err(failed(image))?;
    let decoded = match std::fs::read(raw) {
        Ok(bytes) => decode(&elf, &bytes),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => "the controller has logged nothing\n".to_owned(),
        Err(error) => return Err(failed(raw)(error)),
    };
    std::fs::write(text, decoded).map_err(failed(text))
}

/// Says that the log was not decoded: this program was built without `qemu-log`.
#[cfg(not(feature = "qemu-log"))]
pub fn decode(_elf: &[u8], bytes: &[u8]) -> String {
    format!(
        "the controller's log has {} bytes; this program was built without the feature `qemu-log`, which decodes it\n",
        bytes.len()
    )
}

/// Decodes `bytes`, the log of the image `elf`, to one line per message: device time in µs, level
/// and place in the source where they are known.
#[cfg(feature = "qemu-log")]
pub fn decode(elf: &[u8], bytes: &[u8]) -> String {
    use std::fmt::Write as _;

    use defmt_decoder::{DecodeError, Table};

    let table = match Table::parse(elf) {
        Ok(Some(table)) => table,
        Ok(None) => return "the image has no log table: it was built without defmt\n".to_owned(),
        Err(error) => return format!("the image's log table cannot be read: {error}\n"),
    };
    let locations = table.get_locations(elf).unwrap_or_default();
    let mut decoder = table.new_stream_decoder();
    decoder.received(bytes);
    let (mut text, mut damaged) = (String::new(), 0);
    loop {
        match decoder.decode() {
            Ok(frame) => {
                // Writing to a string does not fail.
                let _ = write!(text, "{}", frame.display(false));
                if let Some(place) = locations.get(&frame.index()) {
                    let file = place.file.file_name().unwrap_or_default().to_string_lossy();
                    let _ = write!(text, "  ({file}:{})", place.line);
                }
                text.push('\n');
            }
            Err(DecodeError::UnexpectedEof) => break,
            Err(DecodeError::Malformed) => {
                damaged += 1;
                if !table.encoding().can_recover() {
                    break;
                }
            }
        }
    }
    if damaged > 0 {
        let _ = writeln!(text, "{damaged} messages could not be decoded");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if a missing log, or a file that is not an image, gives no readable message.
    #[test]
    fn what_cannot_be_decoded_is_said() {
        let said = decode(b"not an ELF", b"abc");
        assert!(said.contains("cannot be read") || said.contains("qemu-log"), "{said}");
        let folder = tempfile::tempdir().expect("a folder");
        let image = folder.path().join("image");
        std::fs::write(&image, b"x").expect("written");
        let text = folder.path().join("text");
        decode_file(&image, &folder.path().join("none"), &text).expect("no log is no error");
        let said = std::fs::read_to_string(&text).expect("a text");
        assert_eq!(said, "the controller has logged nothing\n");
    }
}
