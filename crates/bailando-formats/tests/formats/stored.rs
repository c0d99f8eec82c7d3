//! What the service stores of a motion, read back.

use bailando_formats::{FormatError, OutputFormat, WriteOptions, from_stored, to_stored};

use crate::motion;

#[test]
fn what_is_stored_is_read_back_in_every_format() {
    for fps in [60, 24] {
        let mut before = motion(fps);
        before.warnings.push("a warning".to_owned());
        let stored = to_stored(&before).unwrap();
        let after = from_stored(&stored).unwrap();
        assert_eq!(after.animation, before.animation);
        assert_eq!(after.positions, before.positions);
        assert_eq!(after.continuation, before.continuation);
        for format in OutputFormat::ALL {
            let write = |motion| format.write(motion, &WriteOptions::default()).unwrap();
            assert_eq!(write(&after), write(&before), "{}", format.name());
        }
    }
}

#[test]
fn other_bytes_are_refused() {
    let stored = to_stored(&motion(60)).unwrap();
    for cut in [0, 4, 8, 100, stored.len() - 1] {
        let read = from_stored(&stored[..cut]);
        assert!(matches!(read, Err(FormatError::Stored(_))), "{cut}: {read:?}");
    }
    let mut longer = stored.clone();
    longer.push(0);
    assert!(from_stored(&longer).is_err());
    let mut infinite = stored;
    let end = infinite.len();
    infinite[end - 4..].copy_from_slice(&f32::INFINITY.to_le_bytes());
    assert!(from_stored(&infinite).is_err());
}
