//! Pickled arrays, and pickles that pretend to be.

use super::array::NumpyArray;
use super::*;

/// A [2] float32 array as protocol 3 writes it, without the opcode in front and STOP behind.
const ARRAY: &[u8] = b"cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85C\x01b\x87\
    R(K\x01K\x02\x85cnumpy\ndtype\nX\x02\x00\x00\x00f4\x89\x88\x87R(K\x03X\x01\x00\x00\x00<NNNJ\
    \xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb\x89C\x08\x00\x00\x80\x3f\x00\x00\x00\xc0tb";

fn whole(body: &[u8]) -> Vec<u8> {
    [b"\x80\x03", body, b"."].concat()
}

fn array(bytes: &[u8]) -> NumpyArray {
    let pickled = interpret_arrays(bytes).unwrap();
    match pickled.arena.get(pickled.root) {
        Some(Object::Array(array)) => (**array).clone(),
        other => panic!("no array: {other:?}"),
    }
}

fn problem(body: &[u8]) -> String {
    interpret_arrays(&whole(body)).unwrap_err().to_string()
}

fn replaced(from: &[u8], to: &[u8]) -> Vec<u8> {
    assert_eq!(from.len(), to.len());
    let at = ARRAY.windows(from.len()).position(|w| w == from).unwrap();
    let mut changed = ARRAY.to_vec();
    changed[at..at + to.len()].copy_from_slice(to);
    changed
}

#[test]
fn an_array_is_read_in_either_byte_order() {
    let read = array(&whole(ARRAY));
    assert_eq!(read.shape, [2]);
    assert_eq!(read.values().unwrap(), [1.0, -2.0]);
    let swapped =
        replaced(b"\x00\x00\x80\x3f\x00\x00\x00\xc0", b"\x3f\x80\x00\x00\xc0\x00\x00\x00");
    let at = swapped.iter().position(|&byte| byte == b'<').unwrap();
    let mut swapped = swapped;
    swapped[at] = b'>';
    assert_eq!(array(&whole(&swapped)).values().unwrap(), [1.0, -2.0]);
}

#[test]
fn any_other_global_is_refused_by_name() {
    for (body, name) in [
        (&b"cos\nsystem\nX\x04\x00\x00\x00true\x85R"[..], "os.system"),
        (b"cbuiltins\neval\nX\x01\x00\x00\x001\x85R", "builtins.eval"),
        (b"\x8c\x05posix\x8c\x06system\x93", "posix.system"),
        (b"cnumpy.testing\nrundocs\n)R", "numpy.testing.rundocs"),
        (b"cnumpy\nload\n)R", "numpy.load"),
    ] {
        let problem = problem(body);
        assert!(problem.contains(&format!("`{name}`")), "{problem}");
    }
}

#[test]
fn calls_and_instances_of_anything_else_are_refused() {
    for body in [
        &b"K\x01)R"[..],
        b"}(X\x01\x00\x00\x00aK\x01u)R",
        b"cnumpy\nndarray\n)\x81",
        b"cnumpy\nndarray\n)R",
        b"K\x01Q",
        b"ios\nsystem\n",
        b"\x97",
        b"\x82\x01",
        b"cnumpy\ndtype\nX\x01\x00\x00\x00O\x89\x88\x87R",
        b"c_codecs\nencode\nX\x01\x00\x00\x00aX\x04\x00\x00\x00zlib\x86R",
        b"\x8e\xff\xff\xff\xff\xff\xff\xff\x7f",
        b"\x93",
        b"\x94",
    ] {
        assert!(interpret_arrays(&whole(body)).is_err(), "{body:?}");
    }
    assert!(interpret_arrays(b"\x80\x06N.").is_err());
}

#[test]
fn a_shape_that_does_not_fit_its_bytes_is_refused_before_anything_is_allocated() {
    for (from, to) in [(&b"K\x01K\x02\x85"[..], &b"K\x01K\xff\x85"[..]), (b"f4", b"f8")] {
        assert!(array(&whole(&replaced(from, to))).values().is_err());
    }
}

#[test]
fn a_checkpoint_does_not_know_arrays() {
    assert!(interpret(&[b"\x80\x02", ARRAY, b"."].concat()).is_err());
}

#[test]
fn a_pickle_of_countless_small_things_is_refused_early() {
    for opcode in [b'N', b'(', b']'] {
        let problem = problem(&vec![opcode; 1 << 20]);
        assert!(problem.contains("far more than a few arrays"), "{problem}");
    }
}
