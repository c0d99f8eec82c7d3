use super::*;

fn root(bytes: &[u8]) -> Object {
    let pickled = interpret(bytes).unwrap();
    pickled.arena.get(pickled.root).unwrap().clone()
}

fn problem(bytes: &[u8]) -> String {
    interpret(bytes).unwrap_err().to_string()
}

/// A tensor [2, 2] of storage "7", FloatStorage with 4 values.
const TENSOR: &[u8] = b"\x80\x02ctorch._utils\n_rebuild_tensor_v2\n((X\x07\x00\x00\x00storagector\
    ch\nFloatStorage\nX\x01\x00\x00\x007X\x03\x00\x00\x00cpuK\x04tQK\x00K\x02K\x02\x86K\x02K\x01\
    \x86\x89ccollections\nOrderedDict\n)RtR";

#[test]
fn integers_of_every_width_are_read() {
    assert_eq!(root(b"K\xff."), Object::Int(255));
    assert_eq!(root(b"M\x01\x02."), Object::Int(513));
    assert_eq!(root(b"J\xff\xff\xff\xff."), Object::Int(-1));
    assert_eq!(root(b"\x8a\x00."), Object::Int(0));
    assert_eq!(root(b"\x8a\x02\x00\xff."), Object::Int(-256));
    assert_eq!(root(b"\x8a\x09123456789."), Object::Scalar);
}

#[test]
fn a_dictionary_keeps_the_last_value_of_a_key() {
    let dictionary = b"}(X\x01\x00\x00\x00aK\x01X\x01\x00\x00\x00aK\x02u.";
    let pickled = interpret(&[&dictionary[..], b"trailing"].concat()).unwrap();
    let value = pickled.arena.lookup(pickled.root, "a").unwrap();
    assert_eq!(pickled.arena.int(value), Some(2));
    assert_eq!(pickled.consumed, dictionary.len());
}

#[test]
fn a_tensor_is_a_view_of_its_storage() {
    let Object::Tensor(view) = root(&[TENSOR, b"."].concat()) else {
        panic!("no tensor");
    };
    assert_eq!((&*view.storage.key, view.storage.values), ("7", 4));
    assert_eq!(view.storage.element, ElementType::F32);
    assert_eq!((view.shape, view.strides), (vec![2, 2], vec![2, 1]));
}

#[test]
fn a_parameter_is_its_tensor() {
    let parameter = [b"ctorch._utils\n_rebuild_parameter\n(", TENSOR, b"\x89NtR."].concat();
    assert!(matches!(root(&parameter), Object::Tensor(_)));
}

#[test]
fn unknown_classes_are_inert_and_swallow_their_contents() {
    let easydict = b"ceasydict\nEasyDict\n)\x81(X\x01\x00\x00\x00aK\x01u}b.";
    assert_eq!(root(easydict), Object::Opaque);
    assert_eq!(root(b"cos\nsystem\n(X\x04\x00\x00\x00truetR."), Object::Opaque);
    assert_eq!(root(b"cbuiltins\nlist\n)R(K\x01K\x02e."), Object::Opaque);
}

#[test]
fn opcodes_outside_the_subset_are_refused_by_name() {
    assert_eq!(
        problem(b"\x80\x02ios\nsystem\n."),
        "pickle opcode 0x69 at byte 2 is not one that plain data needs"
    );
    assert!(problem(b"\x80\x04.").contains("protocols up to 2"));
}

#[test]
fn contradictions_are_errors() {
    for bytes in [
        &b"."[..],
        b"",
        b"0.",
        b"u.",
        b"t.",
        b"(0.",
        b"K",
        b"h\x00.",
        b"q\x00.",
        b"a.",
        b"K\x01K\x02a.",
        b"}(K\x01u.",
        b"K\x01K\x02K\x03s.",
        b"K\x01Q.",
        b"X\xff\xff\xff\xffabc",
        b"X\x01\x00\x00\x00\xff.",
        b"cno newline",
        b"ctorch._utils\n_rebuild_tensor_v2\n)R.",
        b"ctorch._utils\n_rebuild_parameter\n)R.",
    ] {
        assert!(interpret(bytes).is_err(), "{bytes:?} was accepted");
    }
}

#[test]
fn a_tuple_that_holds_itself_or_nests_deeply_harms_nothing() {
    assert!(matches!(root(b"]q\x00h\x00a."), Object::List(_)));
    let mut deep = vec![b')'];
    deep.resize(1_000_000, 0x85);
    deep.push(b'.');
    assert!(matches!(root(&deep), Object::Tuple(_)));
}
