//! The part of Python's pickle (protocol 2) that state dictionaries are written in. Nothing is ever called: what a pickle asks to be made is told apart
//! by name, and what is no tensor, container or number stays opaque.

use super::PthError;
use std::collections::HashMap;
use std::rc::Rc;

/// Containers within containers; also keeps damaged files from using up the stack.
const DEEPEST: u8 = 48;

/// A value of a pickle.
#[derive(Clone, Debug)]
pub enum Value {
    /// A whole number; booleans are 0 and 1.
    Int(i64),
    /// A text.
    Text(Rc<str>),
    /// A class or function, "module name".
    Global(Rc<str>),
    /// A tuple or list, or keys and values of a dictionary in turn.
    Items(Rc<Items>),
    /// An array of numbers.
    Tensor(Rc<Tensor>),
    /// Something else.
    Opaque,
}

/// What a container holds.
#[derive(Clone, Debug, Default)]
pub struct Items {
    /// Its values.
    pub values: Vec<Value>,
    depth: u8,
}

/// An array whose values lie in another file of the archive.
#[derive(Clone, Debug, Default)]
pub struct Tensor {
    /// Class of the storage, as `FloatStorage`.
    pub class: String,
    /// Name of the storage's file.
    pub key: String,
    /// First value.
    pub offset: usize,
    /// Shape.
    pub shape: Vec<usize>,
    /// Steps in the storage from one index to the next.
    pub strides: Vec<usize>,
}

impl Value {
    fn items(&self) -> Option<&[Self]> {
        match self {
            Self::Items(items) => Some(&items.values),
            _ => None,
        }
    }

    /// The text, if it is one.
    pub fn text(&self) -> Option<&str> {
        match self {
            Self::Text(text) => Some(text),
            _ => None,
        }
    }

    /// Keys and values of a dictionary.
    pub fn pairs(&self) -> impl Iterator<Item = (&str, &Self)> {
        let items = self.items().unwrap_or_default();
        items.chunks_exact(2).filter_map(|pair| Some((pair[0].text()?, &pair[1])))
    }

    fn sizes(&self) -> Option<Vec<usize>> {
        self.items()?.iter().map(Self::size).collect()
    }

    fn size(&self) -> Option<usize> {
        match self {
            Self::Int(n) => usize::try_from(*n).ok(),
            _ => None,
        }
    }
}

/// What a pickle holds.
///
/// # Errors
/// It is cut short, or uses what no state dictionary needs.
pub fn read(bytes: &[u8]) -> Result<Value, PthError> {
    let mut machine = Machine { bytes, at: 0, stack: Vec::new(), marks: Vec::new(), memo: HashMap::new() };
    loop {
        if let Some(value) = machine.step()? {
            return Ok(value);
        }
    }
}

struct Machine<'a> {
    bytes: &'a [u8],
    at: usize,
    stack: Vec<Value>,
    marks: Vec<usize>,
    memo: HashMap<u32, Value>,
}

impl Machine<'_> {
    /// One instruction; the result at the end.
    fn step(&mut self) -> Result<Option<Value>, PthError> {
        let code = self.take(1)?[0];
        match code {
            0x80 => _ = self.take(1)?,
            b'.' => return self.pop().map(Some),
            b'(' => self.marks.push(self.stack.len()),
            b'}' | b']' | b')' => self.stack.push(Value::Items(Rc::default())),
            b'N' => self.stack.push(Value::Opaque),
            0x88 => self.stack.push(Value::Int(1)),
            0x89 => self.stack.push(Value::Int(0)),
            b'K' => self.int(1)?,
            b'M' => self.int(2)?,
            b'J' => self.int(4)?,
            0x8a => {
                let n = usize::from(self.take(1)?[0]);
                self.int(n)?;
            }
            b'G' => {
                self.take(8)?;
                self.stack.push(Value::Opaque);
            }
            b'X' => {
                let n = self.u32()? as usize;
                let text = String::from_utf8_lossy(self.take(n)?).into();
                self.stack.push(Value::Text(text));
            }
            b'c' => {
                let name = format!("{} {}", self.line()?, self.line()?);
                self.stack.push(Value::Global(name.into()));
            }
            b'q' => {
                let slot = u32::from(self.take(1)?[0]);
                self.keep(slot)?;
            }
            b'r' => {
                let slot = self.u32()?;
                self.keep(slot)?;
            }
            b'h' => {
                let slot = u32::from(self.take(1)?[0]);
                self.recall(slot)?;
            }
            b'j' => {
                let slot = self.u32()?;
                self.recall(slot)?;
            }
            b't' => {
                let values = self.marked()?;
                self.push_items(values)?;
            }
            0x85..=0x87 => {
                let n = usize::from(code - 0x84);
                let from = self.stack.len().checked_sub(n).ok_or(PthError::Pickle("a tuple of nothing"))?;
                let values = self.stack.split_off(from);
                self.push_items(values)?;
            }
            b'a' => {
                let value = self.pop()?;
                self.add(vec![value])?;
            }
            b'e' | b'u' => {
                let values = self.marked()?;
                self.add(values)?;
            }
            b's' => {
                let (value, key) = (self.pop()?, self.pop()?);
                self.add(vec![key, value])?;
            }
            b'Q' => {
                let id = self.pop()?;
                // A storage: ("storage", class, key, place, length). It waits as its own tuple for the tensor that is made of it.
                self.stack.push(id);
            }
            b'R' | 0x81 => {
                let (arguments, made) = (self.pop()?, self.pop()?);
                self.stack.push(make(&made, &arguments));
            }
            // The state of an object: of no interest.
            b'b' => _ = self.pop()?,
            b'0' => _ = self.pop()?,
            _ => return Err(PthError::Opcode(code)),
        }
        Ok(None)
    }

    fn take(&mut self, n: usize) -> Result<&[u8], PthError> {
        let end = self
            .at
            .checked_add(n)
            .filter(|end| *end <= self.bytes.len())
            .ok_or(PthError::Pickle("less than it says"))?;
        let part = &self.bytes[self.at..end];
        self.at = end;
        Ok(part)
    }

    fn u32(&mut self) -> Result<u32, PthError> {
        self.take(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
    }

    /// A whole number of `n` bytes; those of one and two have no sign.
    fn int(&mut self, n: usize) -> Result<(), PthError> {
        let bytes = self.take(n)?;
        if n > 8 {
            self.stack.push(Value::Opaque);
            return Ok(());
        }
        let mut whole = [if n > 2 && bytes[n - 1] >= 0x80 { 0xff } else { 0 }; 8];
        whole[..n].copy_from_slice(bytes);
        self.stack.push(Value::Int(i64::from_le_bytes(whole)));
        Ok(())
    }

    fn line(&mut self) -> Result<String, PthError> {
        let rest = &self.bytes[self.at..];
        let n = rest.iter().position(|b| *b == b'\n').ok_or(PthError::Pickle("a name without an end"))?;
        let line = String::from_utf8_lossy(&rest[..n]).into_owned();
        self.at += n + 1;
        Ok(line)
    }

    fn pop(&mut self) -> Result<Value, PthError> {
        self.stack.pop().ok_or(PthError::Pickle("an empty stack"))
    }

    fn marked(&mut self) -> Result<Vec<Value>, PthError> {
        let from = self.marks.pop().filter(|m| *m <= self.stack.len()).ok_or(PthError::Pickle("no mark"))?;
        Ok(self.stack.split_off(from))
    }

    fn keep(&mut self, slot: u32) -> Result<(), PthError> {
        let value = self.stack.last().cloned().ok_or(PthError::Pickle("an empty stack"))?;
        self.memo.insert(slot, value);
        Ok(())
    }

    fn recall(&mut self, slot: u32) -> Result<(), PthError> {
        let value = self.memo.get(&slot).cloned().ok_or(PthError::Pickle("a value that was never kept"))?;
        self.stack.push(value);
        Ok(())
    }

    fn push_items(&mut self, values: Vec<Value>) -> Result<(), PthError> {
        self.stack.push(Value::Items(Rc::default()));
        self.add(values)
    }

    /// Adds to the container on top of the stack; what lies on an opaque object is dropped.
    fn add(&mut self, values: Vec<Value>) -> Result<(), PthError> {
        let below = |v: &Value| if let Value::Items(items) = v { items.depth + 1 } else { 0 };
        let depth = values.iter().map(below).max().unwrap_or(0);
        if depth > DEEPEST {
            return Err(PthError::Pickle("containers too deep in one another"));
        }
        match self.stack.last_mut() {
            Some(Value::Items(items)) => {
                let items = Rc::make_mut(items);
                items.depth = items.depth.max(depth);
                items.values.extend(values);
                Ok(())
            }
            Some(_) => Ok(()),
            None => Err(PthError::Pickle("an empty stack")),
        }
    }
}

/// What a class or function makes of its arguments.
fn make(made: &Value, arguments: &Value) -> Value {
    let (Value::Global(name), Some(arguments)) = (made, arguments.items()) else {
        return Value::Opaque;
    };
    match &**name {
        "collections OrderedDict" => Value::Items(Rc::default()),
        "torch._utils _rebuild_tensor_v2" => tensor(arguments).map_or(Value::Opaque, |t| Value::Tensor(Rc::new(t))),
        "torch._utils _rebuild_parameter" => arguments.first().cloned().unwrap_or(Value::Opaque),
        _ => Value::Opaque,
    }
}

fn tensor(arguments: &[Value]) -> Option<Tensor> {
    let [storage, offset, shape, strides, ..] = arguments else {
        return None;
    };
    let [kind, Value::Global(class), key, ..] = storage.items()? else {
        return None;
    };
    (kind.text()? == "storage").then_some(())?;
    Some(Tensor {
        class: class.strip_prefix("torch ")?.into(),
        key: key.text()?.into(),
        offset: offset.size()?,
        shape: shape.sizes()?,
        strides: strides.sizes()?,
    })
}
