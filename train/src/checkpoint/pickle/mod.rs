//! An interpreter of the pickle opcodes that a state dictionary needs, and of nothing else.
//!
//! It calls nothing: globals outside a short list become inert objects that swallow whatever is
//! put into them (official checkpoints carry an `EasyDict` beside the weights, ARCHITECTURE
//! section 4). Every opcode adds at most one object whose size is bounded by the bytes read, so
//! memory stays proportional to the pickle.

mod reader;
mod rebuild;
mod value;

pub(crate) use value::{Arena, ElementType, Id, Object, Storage, TensorView};

use std::collections::HashMap;

use super::error::Problem;
use reader::Reader;

/// State dictionaries of the published size have pickles of about 0.1 MB: the pickle grows with
/// the number of tensors, not with their size.
pub(crate) const MAX_PICKLE_BYTES: usize = 4 << 20;

/// One interpreted pickle.
#[derive(Debug)]
pub(crate) struct Pickled {
    pub(crate) arena: Arena,
    pub(crate) root: Id,
    /// Bytes read, up to and including STOP.
    pub(crate) consumed: usize,
}

/// Interprets the pickle that starts at the beginning of `bytes`.
pub(crate) fn interpret(bytes: &[u8]) -> Result<Pickled, Problem> {
    let window = bytes.get(..MAX_PICKLE_BYTES).unwrap_or(bytes);
    let mut machine = Machine::new(window);
    loop {
        if let Some(root) = machine.step()? {
            return Ok(Pickled {
                arena: machine.arena,
                root,
                consumed: machine.reader.offset(),
            });
        }
    }
}

struct Machine<'a> {
    reader: Reader<'a>,
    arena: Arena,
    stack: Vec<Id>,
    /// Height of the stack at each MARK.
    marks: Vec<usize>,
    memo: HashMap<u32, Id>,
}

impl<'a> Machine<'a> {
    fn new(bytes: &'a [u8]) -> Self {
        Self {
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
                self.reader.take(8)?;
                self.push(Object::Scalar);
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
                let class = self.reader.global()?;
                self.push(class);
            }
            b'Q' => self.persistent()?,
            b'R' => self.reduce()?,
            0x81 => self.instantiate()?,
            b'b' => self.build()?,
            _ => return Err(Problem::Opcode { opcode, offset }),
        }
        Ok(None)
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
        match self.reader.byte()? {
            0..=2 => Ok(()),
            _ => Err(self.malformed("only pickle protocols up to 2 are read, PyTorch's default")),
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
        let object = match self.arena.get(callable) {
            Some(Object::OrderedDictClass) => Object::Dict(Vec::new()),
            Some(Object::RebuildTensor) => rebuild::tensor(&self.arena, arguments)
                .map(Object::Tensor)
                .map_err(|what| self.malformed(what))?,
            Some(Object::RebuildParameter) => {
                rebuild::parameter(&self.arena, arguments).map_err(|what| self.malformed(what))?
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
            _ => Object::Opaque,
        };
        self.push(object);
        Ok(())
    }

    /// BUILD sets attributes (a state dictionary's `_metadata`, an `EasyDict`'s fields): ignored.
    fn build(&mut self) -> Result<(), Problem> {
        self.pop()?;
        self.top().map(|_| ())
    }
}

#[cfg(test)]
mod tests;
