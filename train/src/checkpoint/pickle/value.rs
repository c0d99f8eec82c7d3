//! The objects that a pickle may build. They live in one flat arena and refer to each other by
//! index, so that neither cycles nor deep nesting can exhaust the stack or leak.

use std::sync::Arc;

use super::array::{Dtype, NumpyArray, NumpyName, Raw};

/// Index of an object in the [`Arena`].
pub(crate) type Id = usize;

/// Element type of a storage.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ElementType {
    F64,
    F32,
    F16,
    Bf16,
    I64,
    I32,
    I16,
    I8,
    U8,
    Bool,
}

impl ElementType {
    /// The element type of the class `torch.<name>`.
    pub(super) fn of_class(name: &str) -> Option<Self> {
        Some(match name {
            "DoubleStorage" => Self::F64,
            "FloatStorage" => Self::F32,
            "HalfStorage" => Self::F16,
            "BFloat16Storage" => Self::Bf16,
            "LongStorage" => Self::I64,
            "IntStorage" => Self::I32,
            "ShortStorage" => Self::I16,
            "CharStorage" => Self::I8,
            "ByteStorage" => Self::U8,
            "BoolStorage" => Self::Bool,
            _ => return None,
        })
    }

    /// Bytes per element.
    pub(crate) fn bytes(self) -> usize {
        match self {
            Self::F64 | Self::I64 => 8,
            Self::F32 | Self::I32 => 4,
            Self::F16 | Self::Bf16 | Self::I16 => 2,
            Self::I8 | Self::U8 | Self::Bool => 1,
        }
    }

    /// Name for messages.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::F64 => "float64",
            Self::F32 => "float32",
            Self::F16 => "float16",
            Self::Bf16 => "bfloat16",
            Self::I64 => "int64",
            Self::I32 => "int32",
            Self::I16 => "int16",
            Self::I8 => "int8",
            Self::U8 => "uint8",
            Self::Bool => "bool",
        }
    }
}

/// A run of values of one type, stored outside the pickle.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Storage {
    /// Shared, since any number of tensors may name the same storage.
    pub(crate) key: Arc<str>,
    pub(crate) element: ElementType,
    pub(crate) values: usize,
}

/// A strided view of a storage; offset and strides count values.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct TensorView {
    pub(crate) storage: Storage,
    pub(crate) offset: usize,
    pub(crate) shape: Vec<usize>,
    pub(crate) strides: Vec<usize>,
}

/// What a pickle may build.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Object {
    None,
    Bool(bool),
    Int(i64),
    Float(f64),
    /// Integers beyond 64 bits: nothing that is referred to.
    Scalar,
    /// Bytes: nothing but an array's values.
    Raw(Raw),
    Text(Arc<str>),
    Tuple(Vec<Id>),
    List(Vec<Id>),
    Dict(Vec<(Id, Id)>),
    OrderedDictClass,
    RebuildTensor,
    RebuildParameter,
    StorageClass(ElementType),
    /// Any other global: it is never looked up nor called.
    OtherClass,
    /// What calling or instantiating an unknown global would have made; it swallows its contents.
    Opaque,
    Storage(Storage),
    Tensor(Box<TensorView>),
    /// A function or class of NumPy.
    Numpy(NumpyName),
    Dtype(Dtype),
    /// An array that BUILD has not filled yet.
    EmptyArray,
    Array(Box<NumpyArray>),
}

/// Every object that one pickle built.
#[derive(Debug, Default)]
pub(crate) struct Arena {
    objects: Vec<Object>,
}

impl Arena {
    pub(super) fn add(&mut self, object: Object) -> Id {
        self.objects.push(object);
        self.objects.len() - 1
    }

    pub(crate) fn get(&self, id: Id) -> Option<&Object> {
        self.objects.get(id)
    }

    pub(super) fn get_mut(&mut self, id: Id) -> Option<&mut Object> {
        self.objects.get_mut(id)
    }

    /// Every storage that was named.
    pub(crate) fn storages(&self) -> impl Iterator<Item = &Storage> {
        self.objects.iter().filter_map(|object| match object {
            Object::Storage(storage) => Some(storage),
            _ => None,
        })
    }

    pub(crate) fn text(&self, id: Id) -> Option<&Arc<str>> {
        match self.get(id)? {
            Object::Text(text) => Some(text),
            _ => None,
        }
    }

    pub(crate) fn int(&self, id: Id) -> Option<i64> {
        match self.get(id)? {
            Object::Int(value) => Some(*value),
            _ => None,
        }
    }

    /// A non-negative integer.
    pub(super) fn size(&self, id: Id) -> Option<usize> {
        self.int(id).and_then(|value| usize::try_from(value).ok())
    }

    pub(crate) fn entries(&self, id: Id) -> Option<&[(Id, Id)]> {
        match self.get(id)? {
            Object::Dict(entries) => Some(entries),
            _ => None,
        }
    }

    pub(crate) fn items(&self, id: Id) -> Option<&[Id]> {
        match self.get(id)? {
            Object::Tuple(items) | Object::List(items) => Some(items),
            _ => None,
        }
    }

    /// The value beside the text key `key`; the last one wins, as in Python.
    pub(crate) fn lookup(&self, dict: Id, key: &str) -> Option<Id> {
        let entries = self.entries(dict)?;
        let entry =
            entries.iter().rev().find(|(k, _)| self.text(*k).is_some_and(|text| **text == *key));
        entry.map(|&(_, value)| value)
    }
}
