//! Small writers of audio files, without a codec.

/// Returns a WAV file with the given header fields and data, whether they make sense or not.
pub fn wav(channels: u16, rate: u32, bits: u16, data: &[u8]) -> Vec<u8> {
    let declared = u32::try_from(data.len()).unwrap();
    wav_declaring(channels, rate, bits, data, declared)
}

/// Returns a WAV file that declares `declared` bytes of data.
pub fn wav_declaring(channels: u16, rate: u32, bits: u16, data: &[u8], declared: u32) -> Vec<u8> {
    let block = channels.saturating_mul(bits / 8);
    let mut file = b"RIFF".to_vec();
    file.extend(declared.saturating_add(36).to_le_bytes());
    file.extend(b"WAVEfmt ");
    file.extend(16_u32.to_le_bytes());
    file.extend(1_u16.to_le_bytes());
    file.extend(channels.to_le_bytes());
    file.extend(rate.to_le_bytes());
    file.extend(rate.wrapping_mul(u32::from(block)).to_le_bytes());
    file.extend(block.to_le_bytes());
    file.extend(bits.to_le_bytes());
    file.extend(b"data");
    file.extend(declared.to_le_bytes());
    file.extend(data);
    file
}

/// Returns a 16-bit WAV file of `samples`, channels interleaved.
pub fn wav16(channels: u16, rate: u32, samples: &[i16]) -> Vec<u8> {
    let data: Vec<u8> = samples.iter().flat_map(|s| s.to_le_bytes()).collect();
    wav(channels, rate, 16, &data)
}

/// Returns a 16-bit mono WAV file of `samples`, rounded and clipped to full scale.
pub fn mono(rate: u32, samples: &[f32]) -> Vec<u8> {
    let rounded = |sample: &f32| (sample * 32_768.0).round().clamp(-32_768.0, 32_767.0) as i16;
    wav16(1, rate, &samples.iter().map(rounded).collect::<Vec<_>>())
}

/// A FLAC file of digital silence: every subframe of every frame is one CONSTANT value.
pub struct SilentFlac {
    /// Samples a second.
    pub rate: u32,
    /// Channels, 1 to 8.
    pub channels: u8,
    /// Samples of a channel.
    pub frames: u64,
    /// Samples of a channel that the header declares (0 means unknown).
    pub declared: u64,
}

impl SilentFlac {
    const BLOCK: u64 = 65_535;

    /// Returns the file.
    pub fn bytes(&self) -> Vec<u8> {
        let mut file = b"fLaC".to_vec();
        // The last metadata block, STREAMINFO, 34 bytes.
        file.extend([0x80, 0, 0, 34]);
        let block = u16::try_from(Self::BLOCK).unwrap().to_be_bytes();
        file.extend(block.iter().chain(&block));
        file.extend([0; 6]);
        let packed = (u64::from(self.rate) << 44)
            | (u64::from(self.channels - 1) << 41)
            | (15 << 36)
            | self.declared;
        file.extend(packed.to_be_bytes());
        file.extend([0; 16]);
        let mut left = self.frames;
        let mut number = 0;
        while left > 0 {
            // The last block may be shorter; a block of one frame is not worth the trouble.
            let block = left.min(Self::BLOCK);
            file.extend(self.frame(number, u16::try_from(block).unwrap()));
            left -= block;
            number += 1;
        }
        file
    }

    fn frame(&self, number: u32, block: u16) -> Vec<u8> {
        let mut frame = vec![0xff, 0xf8];
        // Block size in 16 bits after the number; rate from STREAMINFO.
        frame.push(0x70);
        // Independent channels, 16 bits a sample.
        frame.push(((self.channels - 1) << 4) | 0x08);
        let mut coded = [0; 4];
        let number = char::from_u32(number).unwrap_or('\u{10000}');
        frame.extend(number.encode_utf8(&mut coded).as_bytes());
        frame.extend((block - 1).to_be_bytes());
        frame.push(crc(&frame, 8, 0x07) as u8);
        for _ in 0..self.channels {
            // CONSTANT subframe without wasted bits, value 0.
            frame.extend([0, 0, 0]);
        }
        let check = crc(&frame, 16, 0x8005) as u16;
        frame.extend(check.to_be_bytes());
        frame
    }
}

fn crc(bytes: &[u8], bits: u32, polynomial: u32) -> u32 {
    let mask = (1 << bits) - 1;
    bytes.iter().fold(0, |crc, &byte| {
        (0..8).fold(crc ^ (u32::from(byte) << (bits - 8)), |crc, _| {
            let carry = (crc >> (bits - 1)) & 1;
            ((crc << 1) & mask) ^ (carry * polynomial)
        })
    })
}
