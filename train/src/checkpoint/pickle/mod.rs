//! An interpreter of the pickle opcodes that plain data needs, and of nothing else.
//!
//! It calls nothing. Two [`Dialect`]s are understood: checkpoints, where globals outside a short
//! list become inert objects that swallow whatever is put into them (official checkpoints carry an
//! `EasyDict` beside the weights, ARCHITECTURE section 4), and dictionaries of NumPy arrays, where
//! any other global is refused by name. Every opcode adds at most one object whose size is bounded
//! by the bytes read, so memory stays proportional to the pickle.

mod array;
mod globals;
mod numpy;
mod reader;
mod rebuild;
#[cfg(test)]
mod tests_numpy;
mod value;

pub(crate) use value::{Arena, ElementType, Id, Object, Storage, TensorView};

use std::collections::HashMap;

use super::error::Problem;
use array::Raw;
use reader::Reader;

/// State dictionaries of the published size have pickles of about 0.1 MB: the pickle grows with
/// the number of tensors, not with their size.
pub(crate) const MAX_PICKLE_BYTES: usize = 4 << 20;

/// What a pickle is expected to hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Dialect {
    /// A PyTorch state dictionary: protocol 2 at most, values in storages outside the pickle.
    Checkpoint,
    /// Dictionaries of NumPy arrays and numbers: protocols 2 to 5, values inside the pickle.
    Arrays,
}

/// One interpreted pickle.
#[derive(Debug)]
pub(crate) struct Pickled {
    pub(crate) arena: Arena,
    pub(crate) root: Id,
    /// Bytes read, up to and including STOP.
    pub(crate) consumed: usize,
}

/// Interprets the pickle of a checkpoint that starts at the beginning of `bytes`.
pub(crate) fn interpret(bytes: &[u8]) -> Result<Pickled, Problem> {
    let window = bytes.get(..MAX_PICKLE_BYTES).unwrap_or(bytes);
    run(Machine::new(window, Dialect::Checkpoint))
}

/// Interprets a pickle of NumPy arrays; the caller bounds its size.
pub(crate) fn interpret_arrays(bytes: &[u8]) -> Result<Pickled, Problem> {
    run(Machine::new(bytes, Dialect::Arrays))
}

/// Opcodes in a pickle of arrays; a dozen of them make an array, however large.
const MAX_ARRAY_OPCODES: usize = 1 << 16;

fn run(mut machine: Machine<'_>) -> Result<Pickled, Problem> {
    let mut opcodes = 0;
    loop {
        opcodes += 1;
        if machine.dialect == Dialect::Arrays && opcodes > MAX_ARRAY_OPCODES {
            return Err(machine.malformed("it holds far more than a few arrays"));
        }
        if let Some(root) = machine.step()? {
            return Ok(Pickled { arena: machine.arena, root, consumed: machine.reader.offset() });
        }
    }
}

struct Machine<'a> {
    dialect: Dialect,
    reader: Reader<'a>,
    arena: Arena,
    stack: Vec<Id>,
    /// Height of the stack at each MARK.
    marks: Vec<usize>,
    memo: HashMap<u32, Id>,
}

impl<'a> Machine<'a> {
    fn new(bytes: &'a [u8], dialect: Dialect) -> Self {
        Self {
            dialect,
            reader: Reader::new(bytes),
            arena: Arena::default(),
            stack: Vec::new(),
            marks: Vec::new(),
            memo: HashMap::new(),
        }
    }

    /// Runs one opcode; the finished object on STOP.
    fn step(&mut self) -> Result<Option<Id>, Problem> {
        let offset = self.reader.offset();
        let opcode = self.reader.byte()?;
        match opcode {
            b'.' => return self.pop().map(Some),
            0x80 => self.protocol()?,
            b'(' => self.marks.push(self.stack.len()),
            b'0' => drop(self.pop()?),
            b'1' => drop(self.pop_mark()?),
            b'N' => self.push(Object::None),
            0x88 => self.push(Object::Bool(true)),
            0x89 => self.push(Object::Bool(false)),
            b'K' | b'M' | b'J' | 0x8a => self.integer(opcode)?,
            b'G' => {
                let value = f64::from_be_bytes(self.reader.array()?);
                self.push(Object::Float(value));
            }
            b'X' => {
                let text = self.reader.text()?;
                self.push(Object::Text(text));
            }
            b')' => self.push(Object::Tuple(Vec::new())),
            0x85..=0x87 => self.short_tuple(usize::from(opcode - 0x84))?,
            b't' => {
                let items = self.pop_mark()?;
                self.push(Object::Tuple(items));
            }
            b']' => self.push(Object::List(Vec::new())),
            b'a' => {
                let item = self.pop()?;
                self.extend_list(&[item])?;
            }
            b'e' => {
                let items = self.pop_mark()?;
                self.extend_list(&items)?;
            }
            b'}' => self.push(Object::Dict(Vec::new())),
            b's' => {
                let value = self.pop()?;
                let key = self.pop()?;
                self.extend_dict(&[key, value])?;
            }
            b'u' => {
                let items = self.pop_mark()?;
                self.extend_dict(&items)?;
            }
            b'q' | b'r' | b'h' | b'j' => self.memory(opcode)?,
            b'c' => {
                let (module, name) = self.reader.global()?;
                self.global(module, name)?;
            }
            b'Q' if self.dialect == Dialect::Checkpoint => self.persistent()?,
            b'R' => self.reduce()?,
            0x81 => self.instantiate()?,
            b'b' => self.build()?,
            _ if self.dialect == Dialect::Arrays => self.later_opcode(opcode, offset)?,
            _ => return Err(Problem::Opcode { opcode, offset }),
        }
        Ok(None)
    }

    /// Opcodes of the protocols 3 to 5.
    fn later_opcode(&mut self, opcode: u8, offset: usize) -> Result<(), Problem> {
        match opcode {
            // A frame says how many bytes to read at once: all are here already.
            0x95 => drop(self.reader.take(8)?),
            0x8c | 0x8d => {
                let text = self.reader.text_of(opcode)?;
                self.push(Object::Text(text));
            }
            b'C' | b'B' | 0x8e | 0x96 => {
                let bytes = self.reader.bytes_of(opcode)?;
                self.push(Object::Raw(Raw::Bytes(bytes.into())));
            }
            0x94 => {
                let id = self.top()?;
                let key = u32::try_from(self.memo.len());
                let key = key.map_err(|_| self.malformed("it memorises too much"))?;
                self.memo.insert(key, id);
            }
            0x93 => {
                let (name, module) = (self.pop()?, self.pop()?);
                let text = |id| self.arena.text(id).cloned();
                let (Some(module), Some(name)) = (text(module), text(name)) else {
                    return Err(self.malformed("a global's name is no text"));
                };
                self.global(module.as_bytes(), name.as_bytes())?;
            }
            _ => return Err(Problem::Opcode { opcode, offset }),
        }
        Ok(())
    }

    /// Pushes what stands for a global; nothing is imported.
    fn global(&mut self, module: &[u8], name: &[u8]) -> Result<(), Problem> {
        let object = match self.dialect {
            Dialect::Checkpoint => globals::of_checkpoint(module, name),
            Dialect::Arrays => globals::of_arrays(module, name)?,
        };
        self.push(object);
        Ok(())
    }

    fn malformed(&self, what: &'static str) -> Problem {
        self.reader.malformed(what)
    }

    fn push(&mut self, object: Object) {
        let id = self.arena.add(object);
        self.stack.push(id);
    }

    /// Pops an object above the latest mark.
    fn pop(&mut self) -> Result<Id, Problem> {
        let floor = self.marks.last().copied().unwrap_or(0);
        if self.stack.len() > floor
            && let Some(id) = self.stack.pop()
        {
            return Ok(id);
        }
        Err(self.malformed("it takes more from the stack than there is"))
    }

    fn pop_mark(&mut self) -> Result<Vec<Id>, Problem> {
        match self.marks.pop() {
            Some(mark) if mark <= self.stack.len() => Ok(self.stack.split_off(mark)),
            _ => Err(self.malformed("a mark is missing")),
        }
    }

    fn top(&self) -> Result<Id, Problem> {
        let top = self.stack.last().copied();
        top.ok_or_else(|| self.malformed("the stack is empty"))
    }

    fn protocol(&mut self) -> Result<(), Problem> {
        match (self.reader.byte()?, self.dialect) {
            (0..=2, _) | (3..=5, Dialect::Arrays) => Ok(()),
            (_, Dialect::Arrays) => Err(self.malformed("only pickle protocols up to 5 are read")),
            (_, Dialect::Checkpoint) => {
                Err(self.malformed("only pickle protocols up to 2 are read, PyTorch's default"))
            }
        }
    }

    fn integer(&mut self, opcode: u8) -> Result<(), Problem> {
        let object = match opcode {
            b'K' => Object::Int(i64::from(self.reader.byte()?)),
            b'M' => Object::Int(i64::from(u16::from_le_bytes(self.reader.array()?))),
            b'J' => Object::Int(i64::from(i32::from_le_bytes(self.reader.array()?))),
            _ => self.reader.long()?,
        };
        self.push(object);
        Ok(())
    }

    fn short_tuple(&mut self, items: usize) -> Result<(), Problem> {
        let mut tuple = Vec::with_capacity(items);
        for _ in 0..items {
            tuple.push(self.pop()?);
        }
        tuple.reverse();
        self.push(Object::Tuple(tuple));
        Ok(())
    }

    fn memory(&mut self, opcode: u8) -> Result<(), Problem> {
        let key = match opcode {
            b'q' | b'h' => u32::from(self.reader.byte()?),
            _ => u32::from_le_bytes(self.reader.array()?),
        };
        if matches!(opcode, b'q' | b'r') {
            let id = self.top()?;
            self.memo.insert(key, id);
            return Ok(());
        }
        match self.memo.get(&key) {
            Some(&id) => {
                self.stack.push(id);
                Ok(())
            }
            None => Err(self.malformed("it recalls an object that was never stored")),
        }
    }

    fn extend_list(&mut self, items: &[Id]) -> Result<(), Problem> {
        let list = self.top()?;
        match self.arena.get_mut(list) {
            Some(Object::List(list)) => list.extend_from_slice(items),
            Some(Object::Opaque) => {}
            _ => return Err(self.malformed("it appends to something that is no list")),
        }
        Ok(())
    }

    fn extend_dict(&mut self, items: &[Id]) -> Result<(), Problem> {
        if !items.len().is_multiple_of(2) {
            return Err(self.malformed("a key without a value"));
        }
        let dict = self.top()?;
        let pairs = items.chunks_exact(2).filter_map(|pair| match pair {
            &[key, value] => Some((key, value)),
            _ => None,
        });
        match self.arena.get_mut(dict) {
            Some(Object::Dict(entries)) => entries.extend(pairs),
            Some(Object::Opaque) => {}
            _ => return Err(self.malformed("it sets items of something that is no dictionary")),
        }
        Ok(())
    }

    fn persistent(&mut self) -> Result<(), Problem> {
        let id = self.pop()?;
        let storage = rebuild::storage(&self.arena, id).map_err(|what| self.malformed(what))?;
        self.push(Object::Storage(storage));
        Ok(())
    }

    fn reduce(&mut self) -> Result<(), Problem> {
        let arguments = self.pop()?;
        let callable = self.pop()?;
        let object =
            match self.arena.get(callable) {
                Some(Object::OrderedDictClass) => Object::Dict(Vec::new()),
                Some(Object::RebuildTensor) => rebuild::tensor(&self.arena, arguments)
                    .map(Object::Tensor)
                    .map_err(|what| self.malformed(what))?,
                Some(Object::RebuildParameter) => rebuild::parameter(&self.arena, arguments)
                    .map_err(|what| self.malformed(what))?,
                Some(&Object::Numpy(name)) => numpy::call(&self.arena, name, arguments)
                    .map_err(|what| self.malformed(what))?,
                _ if self.dialect == Dialect::Arrays => {
                    return Err(self.malformed("it calls something that is no function of NumPy"));
                }
                _ => Object::Opaque,
            };
        self.push(object);
        Ok(())
    }

    fn instantiate(&mut self) -> Result<(), Problem> {
        self.pop()?;
        let class = self.pop()?;
        let object = match self.arena.get(class) {
            Some(Object::OrderedDictClass) => Object::Dict(Vec::new()),
            _ if self.dialect == Dialect::Arrays => {
                return Err(self.malformed("it makes an object of a class"));
            }
            _ => Object::Opaque,
        };
        self.push(object);
        Ok(())
    }

    /// BUILD fills arrays and their types; other attributes (a state dictionary's `_metadata`, an
    /// `EasyDict`'s fields) are ignored.
    fn build(&mut self) -> Result<(), Problem> {
        let state = self.pop()?;
        let target = self.top()?;
        let filled = match self.arena.get(target) {
            Some(Object::EmptyArray) => numpy::filled_array(&self.arena, state),
            Some(&Object::Dtype(dtype)) => numpy::ordered_dtype(&self.arena, dtype, state),
            _ => return Ok(()),
        };
        let filled = filled.map_err(|what| self.malformed(what))?;
        if let Some(object) = self.arena.get_mut(target) {
            *object = filled;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
