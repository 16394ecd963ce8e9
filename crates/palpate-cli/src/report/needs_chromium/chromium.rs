//! A tab of a headless Chromium, controlled through a pipe: the DevTools protocol, whose messages
//! are JSON, each followed by a zero byte.

use std::cell::{Cell, RefCell};
use std::env;
use std::fs::File;
use std::io::{BufRead, BufReader, Write};
use std::path::PathBuf;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::mpsc::{self, Receiver};
use std::time::Duration;

use serde_json::{Value, json};
use tempfile::TempDir;

/// Longest wait for a message.
pub(super) const PATIENCE: Duration = Duration::from_secs(240);

const NAMES: [&str; 4] = ["google-chrome-stable", "google-chrome", "chromium", "chromium-browser"];

const FLAGS: [&str; 16] = [
    "--remote-debugging-pipe",
    "--headless=new",
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--force-color-profile=srgb",
    "--no-first-run",
    "--disable-dev-shm-usage",
    "--disable-extensions",
    "--disable-sync",
    "--disable-breakpad",
    "--disable-background-networking",
    "--disable-background-timer-throttling",
    "--disable-backgrounding-occluded-windows",
    "--disable-renderer-backgrounding",
    "--password-store=basic",
];

pub(super) struct Chromium {
    process: Child,
    commands: RefCell<ChildStdin>,
    messages: Receiver<Value>,
    /// Events that the tab has sent, in order.
    events: RefCell<Vec<Value>>,
    calls: Cell<u64>,
    /// The session with the tab, once there is one.
    tab: Option<String>,
    profile: TempDir,
}

impl Chromium {
    /// Starts the Chromium of this machine and opens an empty tab; the test fails without one.
    pub(super) fn open() -> Self {
        let profile = tempfile::tempdir().unwrap();
        // The pipe is files 3 and 4 of the browser, which only a shell can arrange.
        let mut process = Command::new("sh")
            .args(["-c", r#"exec "$@" 3<&0 4>&1 </dev/null >/dev/null"#, "sh"])
            .arg(installed())
            .args(FLAGS)
            .arg(format!("--user-data-dir={}", profile.path().display()))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(File::create(profile.path().join("stderr")).unwrap())
            .spawn()
            .unwrap();
        let commands = RefCell::new(process.stdin.take().unwrap());
        let messages = messages(process.stdout.take().unwrap());
        let (events, calls) = (RefCell::default(), Cell::default());
        let mut browser = Self { process, commands, messages, events, calls, tab: None, profile };
        let target = browser.call("Target.createTarget", &json!({"url": "about:blank"}));
        let attach = json!({"targetId": target["targetId"], "flatten": true});
        let session = browser.call("Target.attachToTarget", &attach);
        browser.tab = session["sessionId"].as_str().map(str::to_owned);
        browser
    }

    /// Calls a method of the protocol and waits for its result.
    pub(super) fn call(&self, method: &str, params: &Value) -> Value {
        let id = self.calls.get() + 1;
        self.calls.set(id);
        let mut message = json!({"id": id, "method": method, "params": params});
        if let Some(session) = &self.tab {
            message["sessionId"] = json!(session);
        }
        let mut bytes = serde_json::to_vec(&message).unwrap();
        bytes.push(0);
        self.commands.borrow_mut().write_all(&bytes).unwrap_or_else(|_| self.is_gone());
        loop {
            let mut answer = self.next_message();
            if answer["id"] == id {
                assert!(answer.get("error").is_none(), "{method}: {}", answer["error"]);
                return answer["result"].take();
            }
            self.events.borrow_mut().push(answer);
        }
    }

    /// Opens a page and waits until all of it is loaded.
    pub(super) fn navigate(&self, url: &str) {
        self.call("Page.enable", &json!({}));
        self.call("Page.setLifecycleEventsEnabled", &json!({"enabled": true}));
        let loader = self.call("Page.navigate", &json!({"url": url}))["loaderId"].take();
        let loaded = |event: &Value| {
            event["method"] == "Page.lifecycleEvent"
                && event["params"]["name"] == "load"
                && event["params"]["loaderId"] == loader
        };
        while !self.events.borrow().iter().any(loaded) {
            let message = self.next_message();
            self.events.borrow_mut().push(message);
        }
    }

    /// The results of `choose` for the names and parameters of all events so far.
    pub(super) fn events<T>(&self, choose: impl Fn(&str, &Value) -> Option<T>) -> Vec<T> {
        self.call("Runtime.evaluate", &json!({"expression": "0"})); // earlier events have arrived
        let events = self.events.borrow();
        let named = |event: &Value| choose(event["method"].as_str()?, &event["params"]);
        events.iter().filter_map(named).collect()
    }

    fn next_message(&self) -> Value {
        self.messages.recv_timeout(PATIENCE).unwrap_or_else(|_| self.is_gone())
    }

    fn is_gone(&self) -> ! {
        let stderr = std::fs::read_to_string(self.profile.path().join("stderr"));
        panic!("Chromium says no more; its last words: {}", stderr.unwrap_or_default());
    }
}

impl Drop for Chromium {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// The messages of a browser, read by a thread until the browser ends.
fn messages(from: ChildStdout) -> Receiver<Value> {
    let (send, receive) = mpsc::channel();
    std::thread::spawn(move || {
        for message in BufReader::new(from).split(0) {
            let Ok(message) = message.map(|bytes| serde_json::from_slice(&bytes).unwrap()) else {
                return;
            };
            if send.send(message).is_err() {
                return;
            }
        }
    });
    receive
}

/// The program that `CHROME` names, or the first in `PATH`.
fn installed() -> PathBuf {
    if let Some(named) = env::var_os("CHROME").map(PathBuf::from).filter(|path| path.exists()) {
        return named;
    }
    let path = env::var_os("PATH").unwrap_or_default();
    let named = |name| env::split_paths(&path).map(move |folder| folder.join(name));
    NAMES.into_iter().flat_map(named).find(|program| program.is_file()).unwrap_or_else(|| {
        panic!(
            "no Chromium on this machine, in which the report is tried out: install it with \
             `apt-get install --no-install-recommends chromium`, or set CHROME to its path"
        )
    })
}
