//! Topics and messages of a bag, independent of the storage format.

/// Topic on which `palpate convert` marks the starts of touches; used by default if a bag has it.
pub(super) const TOUCH_TOPIC: &str = "/palpate/touch";

/// One topic.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Topic {
    pub(super) name: String,
    /// Type of its messages.
    pub(super) kind: String,
    /// Number of messages, if the bag says.
    pub(super) messages: Option<u64>,
    /// Definition of the type as text, if the bag contains it.
    pub(super) definition: Option<String>,
}

/// Kind of topic that a message belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum TopicRole {
    Sample,
    Marker,
}

/// A message of one of the topics that are read.
#[derive(Debug, Clone)]
pub(super) struct Message {
    pub(super) which: TopicRole,
    /// Time of recording, ns.
    pub(super) time_ns: i64,
    pub(super) data: Vec<u8>,
}

/// Messages in the order of the file. The error is the end of a message to the user.
pub(super) type Messages = Box<dyn Iterator<Item = Result<Message, String>> + Send>;

/// Adds the topics of another file of the bag to `all`.
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
