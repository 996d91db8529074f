//! Checks on images as files and messages carry them.

/// How far from its end a JPEG may have its end-of-image marker, bytes: some cameras fill up their buffers.
const PADDING: usize = 1024;

/// Whether `data` is not a JPEG that was cut short: decoders fill what is missing with grey and say nothing. A JPEG ends with the marker
/// FF D9, which cannot occur within its compressed data (ITU-T T.81, section B.1.1.2).
pub fn is_complete(data: &[u8]) -> bool {
    let end = &data[data.len().saturating_sub(PADDING)..];
    !data.starts_with(&[0xff, 0xd8]) || end.windows(2).any(|marker| marker == [0xff, 0xd9])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_jpeg_without_its_end_is_incomplete() {
        let jpeg = [&[0xff, 0xd8, 0xff][..], &[7; 5000], &[0xff, 0xd9]].concat();
        assert!(is_complete(&jpeg));
        assert!(is_complete(&[&jpeg[..], &[0; 500]].concat()), "padded");
        assert!(!is_complete(&jpeg[..2000]));
        assert!(is_complete(b"\x89PNG") && is_complete(&[]), "no JPEG");
    }
}
