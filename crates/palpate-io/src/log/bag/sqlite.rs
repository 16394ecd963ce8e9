//! One file of SQLite, as rosbag2 writes it: its topics, and the messages of some of them.

use std::collections::VecDeque;
use std::path::Path;

use rusqlite::{Connection, OpenFlags, Result, params_from_iter};

use super::topic::{Message, Messages, Topic, Which};

/// Messages read at once: few enough for memory, many enough for the time that a query takes.
const PAGE: u32 = 256;

fn open(path: &Path) -> Result<Connection> {
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    Connection::open_with_flags(path, flags)
}

/// The topics of a file.
pub(super) fn topics(path: &Path) -> Result<Vec<Topic>> {
    let database = open(path)?;
    // Bags of older releases carry no definitions.
    let known = "SELECT count(*) FROM sqlite_master WHERE name = 'message_definitions'";
    let carried = database.query_row(known, [], |row| row.get::<_, i64>(0))? > 0;
    let definition = if carried {
        "(SELECT encoded_message_definition FROM message_definitions \
         WHERE topic_type = topics.type AND encoding = 'ros2msg' LIMIT 1)"
    } else {
        "NULL"
    };
    let query = format!(
        "SELECT name, type, (SELECT count(*) FROM messages WHERE topic_id = topics.id), \
         {definition} FROM topics ORDER BY id"
    );
    let mut query = database.prepare(&query)?;
    let rows = query.query_map([], |row| {
        Ok(Topic {
            name: row.get(0)?,
            kind: row.get(1)?,
            messages: row.get::<_, i64>(2)?.try_into().ok(),
            definition: row.get::<_, Option<String>>(3)?.filter(|text| !text.trim().is_empty()),
        })
    })?;
    rows.collect()
}

/// The messages of the wanted topics, those of samples and of markers, in the order of their time.
pub(super) fn messages(path: &Path, wanted: &[Option<String>; 2]) -> Result<Messages> {
    let database = open(path)?;
    let numbers = |name: &Option<String>| -> Result<Vec<i64>> {
        let mut query = database.prepare("SELECT id FROM topics WHERE name = ?1")?;
        query.query_map([name], |row| row.get(0))?.collect()
    };
    let wanted = [numbers(&wanted[0])?, numbers(&wanted[1])?];
    let (page, after) = (VecDeque::new(), (i64::MIN, i64::MIN));
    let pages = Pages { database, wanted, page, after, over: false };
    Ok(Box::new(pages.map(|message| message.map_err(|error| error.to_string()))))
}

/// Messages of a file, some at a time.
struct Pages {
    database: Connection,
    /// Numbers of the topics of samples and of markers.
    wanted: [Vec<i64>; 2],
    page: VecDeque<Message>,
    /// Time and number of the message read last.
    after: (i64, i64),
    over: bool,
}

impl Pages {
    fn turn_page(&mut self) -> Result<()> {
        let ids: Vec<i64> = self.wanted.iter().flatten().copied().collect();
        let marks = vec!["?"; ids.len()].join(", ");
        let mut query = self.database.prepare(&format!(
            "SELECT id, topic_id, timestamp, data FROM messages WHERE topic_id IN ({marks}) \
             AND (timestamp, id) > (?, ?) ORDER BY timestamp, id LIMIT {PAGE}"
        ))?;
        let values = ids.iter().copied().chain([self.after.0, self.after.1]);
        let mut rows = query.query(params_from_iter(values))?;
        while let Some(row) = rows.next()? {
            let (id, topic, time_ns): (i64, i64, i64) = (row.get(0)?, row.get(1)?, row.get(2)?);
            let is_sample = self.wanted[0].contains(&topic);
            let which = if is_sample { Which::Sample } else { Which::Marker };
            self.after = (time_ns, id);
            self.page.push_back(Message { which, time_ns, data: row.get(3)? });
        }
        self.over = self.page.is_empty();
        Ok(())
    }
}

impl Iterator for Pages {
    type Item = Result<Message>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.page.is_empty()
            && !self.over
            && let Err(error) = self.turn_page()
        {
            // What came before the fault is handed on; the next page shows it again.
            self.over = self.page.is_empty();
            if self.over {
                return Some(Err(error));
            }
        }
        self.page.pop_front().map(Ok)
    }
}
