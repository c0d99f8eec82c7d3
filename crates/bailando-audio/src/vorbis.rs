//! Durations of Vorbis packets (Vorbis I specification, sections 1.3.2 and 4.2.4): the only thing
//! of a packet that is read outside the decoder.

/// Sizes of the blocks of a stream.
#[derive(Debug)]
pub(crate) struct Blocks {
    /// Samples in a short and a long block.
    sizes: [u64; 2],
    /// Whether each mode has long blocks.
    long: Vec<bool>,
    previous: Option<u64>,
}

impl Blocks {
    /// Reads the identification header (30 bytes) and the setup header.
    pub(crate) fn new(identification: &[u8], setup: &[u8]) -> Option<Self> {
        let sizes = *identification.get(28)?;
        let sizes = [1 << (sizes & 15), 1 << (sizes >> 4)];
        Some(Self { sizes, long: long_modes(setup)?, previous: None })
    }

    /// Returns the samples that the next packet completes: none for the first one.
    pub(crate) fn duration(&mut self, packet: &[u8]) -> u64 {
        let Some(&first) = packet.first() else { return 0 };
        let bits = usize::BITS - (self.long.len() - 1).leading_zeros();
        let mode = usize::from(first >> 1) & ((1 << bits) - 1);
        let Some(&long) = self.long.get(mode).filter(|_| first & 1 == 0) else { return 0 };
        let size = self.sizes[usize::from(long)];
        self.previous.replace(size).map_or(0, |previous| (previous + size) / 4)
    }
}

/// Returns the block flag of every mode. The modes are the end of the setup header, whose beginning
/// needs all codebooks to be read; so it is read backwards, as other demuxers do.
fn long_modes(setup: &[u8]) -> Option<Vec<bool>> {
    const MOST: usize = 64;
    let mut bits = Backwards { bytes: setup, at: 0 };
    while bits.read(1)? == 0 {}
    let (mut flags, mut found) = (Vec::new(), None);
    while flags.len() < MOST {
        let (Some(mapping), Some(transform), Some(window)) =
            (bits.read(8), bits.read(16), bits.read(16))
        else {
            break;
        };
        if mapping > 63 || transform != 0 || window != 0 {
            break;
        }
        let Some(flag) = bits.read(1) else { break };
        flags.push(flag == 1);
        let mut ahead = Backwards { bytes: setup, at: bits.at };
        if ahead.read(6).is_some_and(|count| count as usize + 1 == flags.len()) {
            found = Some(flags.len());
        }
    }
    flags.truncate(found?);
    flags.reverse();
    Some(flags)
}

/// Reads fields from the end of a bit stream that is packed from its lowest bits.
struct Backwards<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl Backwards<'_> {
    fn read(&mut self, bits: usize) -> Option<u32> {
        let mut value = 0;
        for _ in 0..bits {
            let byte = self.bytes.get(self.bytes.len().checked_sub(1 + self.at / 8)?)?;
            value = (value << 1) | u32::from((byte >> (7 - self.at % 8)) & 1);
            self.at += 1;
        }
        Some(value)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn modes_are_found_from_the_end() {
        // Two modes (short, long) with mappings 0 and 1, written from the lowest bits on.
        let mut bits = vec![true, false, true, true];
        let mut push = |value: u32, count: usize| {
            bits.extend((0..count).map(|bit| (value >> bit) & 1 == 1));
        };
        push(1, 6);
        for mode in [0, 1] {
            push(mode, 1);
            push(0, 32);
            push(mode, 8);
        }
        push(1, 1);
        let setup: Vec<u8> = bits
            .chunks(8)
            .map(|byte| byte.iter().rev().fold(0, |all, &bit| (all << 1) | u8::from(bit)))
            .collect();
        assert_eq!(long_modes(&setup), Some(vec![false, true]));
        let mut identification = [0; 30];
        identification[28] = 0xb8;
        let mut blocks = Blocks::new(&identification, &setup).unwrap();
        let (short, long) = ([0b00], [0b10]);
        let durations = [short, short, long, long].map(|packet| blocks.duration(&packet));
        assert_eq!(durations, [0, 128, (256 + 2_048) / 4, 1_024]);
        assert_eq!(blocks.duration(&[1]), 0, "no audio");
    }
}
