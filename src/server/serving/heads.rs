//! The heads of requests over HTTP/2, as far as a connection must see them to know that one does
//! not come to its end (RFC 9113, sections 4.1 and 6.10).

const FRAME_HEAD: usize = 9;
const PREFACE: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n";
const HEADERS: u8 = 1;
const CONTINUATION: u8 = 9;
const END_HEADERS: u8 = 4;

/// Follows what a client sends: whether a head, or the beginning of any frame, is incomplete.
#[derive(Debug, Default)]
pub(super) struct Heads {
    preface: usize,
    /// Not HTTP/2.
    other: bool,
    head: Vec<u8>,
    /// Bytes of the current frame that are still to come.
    payload_left: usize,
    /// The current frame belongs to the head of a request.
    in_head: bool,
    /// A frame with the rest of a head must follow.
    unfinished: bool,
}

impl Heads {
    pub(super) fn read(&mut self, mut bytes: &[u8]) {
        while let Some((&next, rest)) = bytes.split_first() {
            if self.other {
                return;
            }
            if let Some(&wanted) = PREFACE.get(self.preface) {
                self.other = next != wanted;
                self.preface += 1;
                bytes = rest;
            } else if self.payload_left > 0 {
                let skipped = self.payload_left.min(bytes.len());
                self.payload_left -= skipped;
                bytes = bytes.get(skipped..).unwrap_or_default();
            } else {
                self.head.push(next);
                bytes = rest;
                if let &[a, b, c, kind, flags, ..] = &self.head[..]
                    && self.head.len() == FRAME_HEAD
                {
                    self.payload_left = u32::from_be_bytes([0, a, b, c]) as usize;
                    self.in_head = kind == HEADERS || kind == CONTINUATION;
                    self.unfinished = match self.in_head {
                        true => flags & END_HEADERS == 0,
                        false => self.unfinished,
                    };
                    self.head.clear();
                }
            }
        }
    }

    /// Whether the client does not speak HTTP/2.
    pub(super) fn is_http1(&self) -> bool {
        self.other
    }

    /// Whether something has begun that its sender must end soon.
    pub(super) fn is_incomplete(&self) -> bool {
        let partial = !self.head.is_empty() || self.in_head && self.payload_left > 0;
        !self.other && (partial || self.unfinished)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn after(sent: &[&[u8]]) -> bool {
        let mut heads = Heads::default();
        heads.read(PREFACE);
        // However it arrives.
        sent.concat().chunks(5).for_each(|bytes| heads.read(bytes));
        heads.is_incomplete()
    }

    #[test]
    fn a_head_is_incomplete_until_its_end_has_come() {
        let data = [0, 0, 9, 0, 0, 0, 0, 0, 1, 1, 2, 3];
        let begun = [0, 0, 1, HEADERS, 1, 0, 0, 0, 1, 0x82];
        let end = [0, 0, 1, CONTINUATION, END_HEADERS, 0, 0, 0, 1, 0x86];
        assert!(!after(&[]));
        assert!(!after(&[&data]), "the body of a request has a time of its own");
        assert!(after(&[&begun]) && !after(&[&begun, &end]));
        assert!(after(&[&begun, &end[..9]]) && after(&[&end[..3]]));
        let mut http1 = Heads::default();
        http1.read(b"GET / HTTP/1.1\r\nHo");
        assert!(!http1.is_incomplete());
    }
}
