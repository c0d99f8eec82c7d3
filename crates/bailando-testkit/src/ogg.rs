//! Pages of Ogg files, taken apart and put together.

/// Splits a whole file into its pages.
#[must_use]
pub fn pages(file: &[u8]) -> Vec<Vec<u8>> {
    let (mut at, mut pages) = (0, Vec::new());
    while at < file.len() {
        let segments = usize::from(file[at + 26]);
        let table = &file[at + 27..at + 27 + segments];
        let body: usize = table.iter().map(|&size| usize::from(size)).sum();
        let end = at + 27 + segments + body;
        pages.push(file[at..end].to_vec());
        at = end;
    }
    pages
}

/// Returns a page with one packet of at most 65,024 bytes.
#[must_use]
pub fn page(flags: u8, granule: i64, serial: u32, sequence: u32, packet: &[u8]) -> Vec<u8> {
    let mut page = b"OggS\0".to_vec();
    page.push(flags);
    page.extend(granule.to_le_bytes());
    page.extend(serial.to_le_bytes());
    page.extend(sequence.to_le_bytes());
    page.extend([0; 4]);
    let full = packet.len() / 255;
    page.push(u8::try_from(full + 1).unwrap());
    page.extend(std::iter::repeat_n(255, full));
    page.push(u8::try_from(packet.len() % 255).unwrap());
    page.extend(packet);
    seal(&mut page);
    page
}

/// Sets the time stamp of a page.
pub fn set_granule(page: &mut [u8], granule: i64) {
    page[6..14].copy_from_slice(&granule.to_le_bytes());
    seal(page);
}

/// Computes a page's checksum.
pub fn seal(page: &mut [u8]) {
    page[22..26].fill(0);
    let sum = page.iter().fold(0_u32, |sum, &byte| {
        (0..8).fold(sum ^ (u32::from(byte) << 24), |sum, _| {
            (sum << 1) ^ if sum >> 31 == 1 { 0x04c1_1db7 } else { 0 }
        })
    });
    page[22..26].copy_from_slice(&sum.to_le_bytes());
}
