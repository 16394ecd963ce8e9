//! Reads one SQLite file of rosbag2: its topics, and the messages of some of them.

use std::collections::VecDeque;
use std::path::Path;
use std::time::{Duration, Instant};

use rusqlite::config::DbConfig;
use rusqlite::limits::Limit;
use rusqlite::{Connection, ErrorCode, OpenFlags, OptionalExtension, Result, params_from_iter};

use super::topic::{Message, Messages, Topic, TopicRole};
use crate::input;

/// Messages read with one query: a compromise between memory and the time of the queries.
const PAGE: u32 = 256;

/// Divisor of [`input::largest`] that gives the largest size of one value: usually 256 MiB, an
/// image of a hundred megapixels.
const PART: u64 = 4;
/// Time limit of a query: a crafted file can make a query arbitrarily slow.
const LONGEST: Duration = Duration::from_secs(30);
/// Steps of a query between two checks of the time limit.
const STEPS: i32 = 10_000;

fn open(path: &Path) -> Result<Connection> {
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let database = Connection::open_with_flags(path, flags)?;
    // A view can need any amount of time and memory, and rosbag2 writes none.
    database.set_db_config(DbConfig::SQLITE_DBCONFIG_ENABLE_VIEW, false)?;
    database.set_db_config(DbConfig::SQLITE_DBCONFIG_TRUSTED_SCHEMA, false)?;
    let largest = i32::try_from(input::largest() / PART).unwrap_or(i32::MAX);
    database.set_limit(Limit::SQLITE_LIMIT_LENGTH, largest)?;
    Ok(database)
}

/// Describes an error, as the end of a message to the user.
pub(super) fn in_words(error: &rusqlite::Error) -> String {
    match error.sqlite_error_code() {
        Some(ErrorCode::DatabaseCorrupt) => format!(
            "{error} (was the recording, or a copy of it, cut short?); copy it again, or save what is left with \
             `sqlite3 BAG.db3 .recover | sqlite3 SAVED.db3`"
        ),
        _ => error.to_string(),
    }
}

/// Starts the time limit of the next query.
fn start_clock(database: &mut Connection) -> Result<()> {
    let started = Instant::now();
    database.progress_handler(STEPS, Some(move || started.elapsed() > LONGEST))
}

/// The topics of a file.
pub(super) fn topics(path: &Path) -> Result<Vec<Topic>> {
    let mut database = open(path)?;
    start_clock(&mut database)?;
    // Bags of older releases of rosbag2 contain no definitions.
    let known = "SELECT count(*) FROM sqlite_master WHERE name = 'message_definitions'";
    let carried = database.query_row(known, [], |row| row.get::<_, i64>(0))? > 0;
    let listed: Vec<(i64, String, String)> = {
        let mut query = database.prepare("SELECT id, name, type FROM topics ORDER BY id")?;
        let rows = query.query_map([], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?)))?;
        rows.collect::<Result<_>>()?
    };
    let topics = listed.into_iter().map(|(id, name, kind)| {
        start_clock(&mut database)?;
        let definition = if carried { definition(&database, &kind)? } else { None };
        let messages = count(&database, id)?;
        Ok(Topic { name, kind, messages, definition })
    });
    topics.collect()
}

/// The definition of a type, if there is one.
fn definition(database: &Connection, kind: &str) -> Result<Option<String>> {
    let query = "SELECT encoded_message_definition FROM message_definitions \
                 WHERE topic_type = ?1 AND encoding = 'ros2msg' LIMIT 1";
    let found: Option<Option<String>> =
        database.query_row(query, [kind], |row| row.get(0)).optional()?;
    Ok(found.flatten().filter(|text| !text.trim().is_empty()))
}

/// Number of messages of a topic; `None` if counting exceeds the time limit.
fn count(database: &Connection, topic: i64) -> Result<Option<u64>> {
    let query = "SELECT count(*) FROM messages WHERE topic_id = ?1";
    match database.query_row(query, [topic], |row| row.get::<_, i64>(0)) {
        Ok(count) => Ok(count.try_into().ok()),
        Err(error) if error.sqlite_error_code() == Some(ErrorCode::OperationInterrupted) => {
            Ok(None)
        }
        Err(error) => Err(error),
    }
}

/// The messages on the wanted topics in order of time; `wanted` names the topics of samples and of
/// markers.
pub(super) fn messages(path: &Path, wanted: &[Option<String>; 2]) -> Result<Messages> {
    let mut database = open(path)?;
    start_clock(&mut database)?;
    let numbers = |name: &Option<String>| -> Result<Vec<i64>> {
        let mut query = database.prepare("SELECT id FROM topics WHERE name = ?1")?;
        query.query_map([name], |row| row.get(0))?.collect()
    };
    let wanted = [numbers(&wanted[0])?, numbers(&wanted[1])?];
    let (page, after) = (VecDeque::new(), (i64::MIN, i64::MIN));
    let pages = Pages { database, wanted, page, after, over: false };
    Ok(Box::new(pages.map(|message| message.map_err(|error| in_words(&error)))))
}

/// Messages of a file, read page by page.
struct Pages {
    database: Connection,
    /// Row ids of the topics of samples and of markers.
    wanted: [Vec<i64>; 2],
    page: VecDeque<Message>,
    /// Time, ns, and row id of the message read last.
    after: (i64, i64),
    over: bool,
}

impl Pages {
    fn turn_page(&mut self) -> Result<()> {
        start_clock(&mut self.database)?;
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
            let which = if is_sample { TopicRole::Sample } else { TopicRole::Marker };
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
            // Messages read before the error are returned first; the next page repeats the error.
            self.over = self.page.is_empty();
            if self.over {
                return Some(Err(error));
            }
        }
        self.page.pop_front().map(Ok)
    }
}
