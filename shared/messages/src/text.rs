//! Short text of fixed size.

use bytemuck::{Pod, Zeroable};
use iceoryx2::prelude::ZeroCopySend;

/// Text of at most 48 bytes, padded with zeros; longer text is cut at a character and ends in `~`.
#[derive(Clone, Copy, PartialEq, Eq, Pod, Zeroable, ZeroCopySend)]
#[repr(C)]
pub struct Text {
    bytes: [u8; 48],
}

impl Text {
    /// The text as far as it fits.
    #[must_use]
    pub fn new(text: &str) -> Self {
        let mut bytes = [0; 48];
        if text.len() <= bytes.len() {
            bytes[..text.len()].copy_from_slice(text.as_bytes());
        } else {
            let end = text.floor_char_boundary(bytes.len() - 1);
            bytes[..end].copy_from_slice(&text.as_bytes()[..end]);
            bytes[end] = b'~';
        }
        Self { bytes }
    }

    /// The text up to the first zero, as far as it is UTF-8.
    #[must_use]
    pub fn as_str(&self) -> &str {
        let bytes = self.bytes.split(|&byte| byte == 0).next().unwrap_or_default();
        match std::str::from_utf8(bytes) {
            Ok(text) => text,
            Err(error) => std::str::from_utf8(&bytes[..error.valid_up_to()]).unwrap_or_default(),
        }
    }
}

impl Default for Text {
    fn default() -> Self {
        Self { bytes: [0; 48] }
    }
}

impl std::fmt::Debug for Text {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.as_str().fmt(f)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_fits_or_is_visibly_cut() {
        assert_eq!(Text::new("packman").as_str(), "packman");
        assert_eq!(Text::new(&"x".repeat(48)).as_str(), "x".repeat(48));
        assert_eq!(Text::new(&"x".repeat(49)).as_str(), "x".repeat(47) + "~");
        assert_eq!(Text::new(&"ä".repeat(30)).as_str(), "ä".repeat(23) + "~");
    }

    #[test]
    fn rubbish_reads_as_what_is_valid_of_it() {
        let mut text = Text::new("ok");
        text.bytes[2] = 0xff;
        assert_eq!(text.as_str(), "ok");
    }
}
