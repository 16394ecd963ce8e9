//! Extracts wanted fields from a message of ROS 2 by the definition of its type.
//!
//! A message is CDR: values one after another, each aligned to its size, strings and sequences
//! preceded by their length. Only the definition gives the order of the fields, and a type may have
//! changed between releases of its package, so the definition that the bag contains is used.
//! `re_ros_msg` parses definitions and `re_cdr` reads values; the messages are decoded here, since
//! the decoder of `re_ros_msg` allocates whatever length a message claims.
//!
//! The module is independent of topics and joints.

use re_cdr::{BigEndian, ByteOrder, CdrReader, Error, LittleEndian};
use re_ros_msg::MessageSchema;
use re_ros_msg::message_spec::{ArraySize, BuiltInType, ComplexType, MessageSpecification, Type};

/// Deepest nesting of messages in messages; a deeper definition is refused.
const DEEPEST: usize = 16;
/// Largest number of fields, inner messages included; a definition with more is refused.
const MAX_FIELDS: usize = 4096;
/// Largest number of values in a wanted field; a message with more is refused.
const MAX_VALUES: usize = 4096;

/// Use of a wanted field.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Slot {
    Seconds,
    Nanoseconds,
    Names,
    Positions,
    Torques,
    /// A value of any type, as text.
    Text,
}

/// Values of the wanted fields of one message.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Taken {
    pub(super) seconds: i64,
    pub(super) nanoseconds: i64,
    pub(super) names: Vec<String>,
    pub(super) positions: Vec<f64>,
    pub(super) torques: Vec<f64>,
    pub(super) text: Option<String>,
}

#[derive(Debug, Clone)]
enum Node {
    Value(BuiltInType, Option<Slot>),
    /// Array with its length, or `None` if the length is written before the elements.
    Many(Option<usize>, Box<Node>),
    Message(Vec<Node>),
}

/// The order of the values of a message, with marks on the wanted ones.
#[derive(Debug, Clone)]
pub(super) struct Layout {
    root: Node,
}

impl Layout {
    /// Compiles a definition: the text of the message type, then those of its inner types,
    /// separated by lines of `=`. `wanted` gives fields by their path, such as `header.stamp.sec`.
    /// The error is the end of a message to the user.
    pub(super) fn of(
        kind: &str,
        definition: &str,
        wanted: &[(&str, Slot)],
    ) -> Result<Self, String> {
        let schema = MessageSchema::parse(kind, definition)
            .map_err(|error| format!("its definition cannot be read ({error:#})"))?;
        let mut walk = Compiler { schema: &schema, wanted, found: 0, fields: 0 };
        let root = walk.message(&schema.spec, "", 0)?;
        if walk.found != wanted.len() {
            let fields: Vec<&str> =
                schema.spec.fields.iter().map(|field| field.name.as_str()).collect();
            let paths: Vec<&str> = wanted.iter().map(|(path, _)| *path).collect();
            let (paths, fields) = (paths.join(", "), fields.join(", "));
            return Err(format!("the fields {paths} are needed, and it has {fields}"));
        }
        Ok(Self { root })
    }

    /// Extracts the wanted fields of a message. The error is the end of a message to the user.
    pub(super) fn take(&self, data: &[u8]) -> Result<Taken, String> {
        let Some((head, body)) = data.split_at_checked(4) else {
            return Err(format!("it has {} bytes, less than the header of a message", data.len()));
        };
        let mut taken = Taken::default();
        match [head[0], head[1]] {
            [0, 1] => walk(&mut CdrReader::<LittleEndian>::new(body), &self.root, &mut taken),
            [0, 0] => walk(&mut CdrReader::<BigEndian>::new(body), &self.root, &mut taken),
            [a, b] => {
                return Err(format!("it is encoded as {a:02x}{b:02x}; only plain CDR is read"));
            }
        }
        .map_err(|error| format!("its {} bytes do not fit its definition ({error})", data.len()))?;
        Ok(taken)
    }
}

/// Compiles a definition to a [`Layout`].
struct Compiler<'a> {
    schema: &'a MessageSchema,
    wanted: &'a [(&'a str, Slot)],
    found: usize,
    fields: usize,
}

impl<'a> Compiler<'a> {
    fn message(
        &mut self,
        spec: &MessageSpecification,
        path: &str,
        depth: usize,
    ) -> Result<Node, String> {
        self.fields += spec.fields.len();
        if depth > DEEPEST || self.fields > MAX_FIELDS {
            return Err("its definition is nested too deeply, or has too many fields".to_owned());
        }
        if spec.fields.is_empty() {
            return Ok(Node::Value(BuiltInType::Byte, None)); // an empty message takes one byte
        }
        let mut parts = Vec::new();
        for field in &spec.fields {
            let path =
                if path.is_empty() { field.name.clone() } else { format!("{path}.{}", field.name) };
            parts.push(self.node(spec, &field.ty, &path, depth)?);
        }
        Ok(Node::Message(parts))
    }

    fn node(
        &mut self,
        scope: &MessageSpecification,
        kind: &Type,
        path: &str,
        depth: usize,
    ) -> Result<Node, String> {
        match kind {
            Type::BuiltIn(BuiltInType::WString(_)) => {
                Err(format!("its field `{path}` is a wide string, which is not read"))
            }
            Type::BuiltIn(kind) => {
                let slot = self.wanted.iter().find(|(wanted, _)| *wanted == path);
                self.found += usize::from(slot.is_some());
                Ok(Node::Value(kind.clone(), slot.map(|(_, slot)| *slot)))
            }
            Type::Complex(kind) => {
                let spec = self.resolve(scope, kind)?;
                self.message(spec, path, depth + 1)
            }
            Type::Array { ty, size } => {
                let of = Box::new(self.node(scope, ty, path, depth)?);
                Ok(match size {
                    ArraySize::Fixed(count) => Node::Many(Some(*count), of),
                    ArraySize::Bounded(_) | ArraySize::Unbounded => Node::Many(None, of),
                })
            }
        }
    }

    /// The definition of an inner message.
    fn resolve(
        &self,
        scope: &MessageSpecification,
        kind: &ComplexType,
    ) -> Result<&'a MessageSpecification, String> {
        let full = match kind {
            ComplexType::Absolute { package, name } => plain(&format!("{package}/{name}")),
            ComplexType::Relative { name } => {
                let package = scope.name.split('/').next().unwrap_or_default();
                format!("{package}/{name}")
            }
        };
        let mut inner = self.schema.dependencies.iter();
        inner.find(|spec| plain(&spec.name) == full).ok_or_else(|| {
            format!("its definition refers to `{full}`, which the bag does not hold")
        })
    }
}

/// The name of a type without `/msg/`, which some programs write.
pub(super) fn plain(kind: &str) -> String {
    kind.replacen("/msg/", "/", 1)
}

/// A value that was read.
enum Value {
    Whole(i64),
    Float(f64),
    Text(String),
}

/// Reads the values in order and stores the wanted ones in `taken`.
fn walk<B: ByteOrder>(
    reader: &mut CdrReader<'_, B>,
    node: &Node,
    taken: &mut Taken,
) -> Result<(), Error> {
    match node {
        Node::Value(kind, Some(slot)) => taken.put(*slot, value(reader, kind)?),
        // Unwanted text may have any encoding.
        Node::Value(BuiltInType::String(_), None) => reader.read_byte_sequence().map(|_| ()),
        Node::Value(kind, None) => value(reader, kind).map(|_| ()),
        Node::Message(parts) => parts.iter().try_for_each(|part| walk(reader, part, taken)),
        Node::Many(count, of) => {
            let count = match count {
                Some(count) => *count,
                None => reader.read_u32()? as usize,
            };
            // Every element has at least one byte, so a false count ends with an error at the end
            // of the message.
            (0..count).try_for_each(|_| walk(reader, of, taken))
        }
    }
}

fn value<B: ByteOrder>(reader: &mut CdrReader<'_, B>, kind: &BuiltInType) -> Result<Value, Error> {
    Ok(match kind {
        BuiltInType::Bool | BuiltInType::Byte | BuiltInType::Char | BuiltInType::UInt8 => {
            Value::Whole(reader.read_u8()?.into())
        }
        BuiltInType::UInt16 => Value::Whole(reader.read_u16()?.into()),
        BuiltInType::UInt32 => Value::Whole(reader.read_u32()?.into()),
        BuiltInType::UInt64 => Value::Whole(reader.read_u64()?.cast_signed()),
        BuiltInType::Int8 => Value::Whole(reader.read_i8()?.into()),
        BuiltInType::Int16 => Value::Whole(reader.read_i16()?.into()),
        BuiltInType::Int32 => Value::Whole(reader.read_i32()?.into()),
        BuiltInType::Int64 => Value::Whole(reader.read_i64()?),
        BuiltInType::Float32 => Value::Float(reader.read_f32()?.into()),
        BuiltInType::Float64 => Value::Float(reader.read_f64()?),
        BuiltInType::String(_) => Value::Text(reader.read_str()?.to_owned()),
        BuiltInType::WString(_) => return Err(Error::Custom("a wide string".to_owned())),
    })
}

impl Taken {
    /// Stores a value in the field for its slot.
    fn put(&mut self, slot: Slot, value: Value) -> Result<(), Error> {
        match (slot, value) {
            (Slot::Seconds, Value::Whole(seconds)) => self.seconds = seconds,
            (Slot::Nanoseconds, Value::Whole(nanoseconds)) => self.nanoseconds = nanoseconds,
            (Slot::Names, Value::Text(name)) if self.names.len() < MAX_VALUES => {
                self.names.push(name)
            }
            (Slot::Positions, Value::Float(position)) if self.positions.len() < MAX_VALUES => {
                self.positions.push(position)
            }
            (Slot::Torques, Value::Float(torque)) if self.torques.len() < MAX_VALUES => {
                self.torques.push(torque)
            }
            (Slot::Text, Value::Text(text)) => self.text = Some(text),
            (Slot::Text, Value::Whole(number)) => self.text = Some(number.to_string()),
            (Slot::Text, Value::Float(number)) => self.text = Some(number.to_string()),
            _ => {
                return Err(Error::Custom(format!(
                    "the field of the {slot:?} holds values of another kind, or too many"
                )));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use re_cdr::CdrWriter;

    const DEFINITION: &str = "bool early\nother/Stamp stamp\nuint16[3] words\nfloat64[] q\n\
        string[] name\nInner[<=2] parts\nfloat32[2] tau\n\
        ================\nMSG: other/Stamp\nint32 sec\nuint32 nanosec\n\
        ================\nMSG: here/Inner\nstring text\nfloat64 value\n";
    const WANTED: &[(&str, Slot)] = &[
        ("stamp.sec", Slot::Seconds),
        ("stamp.nanosec", Slot::Nanoseconds),
        ("q", Slot::Positions),
        ("name", Slot::Names),
        ("tau", Slot::Torques),
    ];

    fn layout() -> Layout {
        Layout::of("here/Message", DEFINITION, WANTED).unwrap()
    }

    fn message<B: ByteOrder>(head: [u8; 4]) -> Vec<u8> {
        let mut body = Vec::new();
        let mut writer = CdrWriter::<B>::new(&mut body);
        writer.write_bool(true);
        writer.write_i32(-7);
        writer.write_u32(9);
        (1..4).for_each(|word| writer.write_u16(word));
        writer.write_u32(2);
        [0.25, -3.5].iter().for_each(|&q| writer.write_f64(q));
        writer.write_u32(2);
        ["a", "bc"].iter().for_each(|name| writer.write_string(name));
        writer.write_u32(1);
        writer.write_string("odd");
        writer.write_f64(1.0);
        [0.5, 1.5].iter().for_each(|&tau| writer.write_f32(tau));
        [head.to_vec(), body].concat()
    }

    #[test]
    fn fields_are_found_by_the_definition_in_either_byte_order() {
        let expected = Taken {
            seconds: -7,
            nanoseconds: 9,
            names: vec!["a".to_owned(), "bc".to_owned()],
            positions: vec![0.25, -3.5],
            torques: vec![0.5, 1.5],
            text: None,
        };
        let little = message::<LittleEndian>([0, 1, 0, 0]);
        assert_eq!(layout().take(&little), Ok(expected.clone()));
        assert_eq!(layout().take(&message::<BigEndian>([0, 0, 0, 0])), Ok(expected));
    }

    #[test]
    fn a_definition_that_cannot_be_used_is_reported() {
        let error =
            |definition: &str, wanted| Layout::of("here/Message", definition, wanted).unwrap_err();
        assert!(error("float64[] p\n", WANTED).contains("and it has p"));
        assert!(error("Gone x\n", &[]).contains("`here/Gone`"));
        assert!(error("wstring x\n", &[]).contains("wide string"));
        let endless = "A a\n===\nMSG: here/A\nA a\n";
        assert!(error(endless, &[]).contains("nested too deeply"));
        let encoded = layout().take(&message::<LittleEndian>([0, 7, 0, 0])).unwrap_err();
        assert!(encoded.contains("0007"), "{encoded}");
        assert!(layout().take(&[0]).unwrap_err().contains("1 bytes"));
    }

    proptest! {
        #[test]
        fn a_cut_or_changed_message_is_refused_or_read_without_a_panic(
            cut in 0_usize..120, at in 0_usize..120, byte in any::<u8>(),
        ) {
            let mut bytes = message::<LittleEndian>([0, 1, 0, 0]);
            let whole = bytes.len();
            if cut < whole {
                prop_assert!(layout().take(&bytes[..cut]).is_err());
            }
            bytes[at % whole] = byte;
            let _ = layout().take(&bytes);
        }

        #[test]
        fn no_definition_makes_it_panic(text in "[a-z/\\[\\]<=#0-9 \n]{0,80}") {
            let _ = Layout::of("here/Message", &text, &[]);
        }
    }
}
