//! What the files of a bag hold, whichever way they are stored: topics and their messages.

/// Where `palpate convert` marks the touches that it writes; read even if no option names it.
pub(super) const TOUCH_TOPIC: &str = "/palpate/touch";

/// One topic.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Topic {
    pub(super) name: String,
    /// Type of its messages.
    pub(super) kind: String,
    /// How many there are, if the bag says.
    pub(super) messages: Option<u64>,
    /// The definition of the type, as text, if the bag carries it.
    pub(super) definition: Option<String>,
}

/// Of which topic a message is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Which {
    Sample,
    Marker,
}

/// A message of one of the topics that are read.
#[derive(Debug, Clone)]
pub(super) struct Message {
    pub(super) which: Which,
    /// When it was recorded.
    pub(super) time_ns: i64,
    pub(super) data: Vec<u8>,
}

/// Messages in the order of the file. An error is half a sentence for the user.
pub(super) type Messages = Box<dyn Iterator<Item = Result<Message, String>> + Send>;

/// Adds the topics of another file of the bag.
pub(super) fn merge(all: &mut Vec<Topic>, others: Vec<Topic>) {
    for topic in others {
        match all.iter_mut().find(|known| known.name == topic.name) {
            Some(known) => {
                known.messages = known.messages.zip(topic.messages).map(|(a, b)| a + b);
                known.definition = known.definition.take().or(topic.definition);
            }
            None => all.push(topic),
        }
    }
}
