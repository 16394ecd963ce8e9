//! The pages as a reader meets them: opened from a file in a headless Chromium, and used.

mod extrapolation;
mod report;

use std::ffi::OsStr;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use headless_chrome::browser::default_executable;
use headless_chrome::protocol::cdp::types::Event;
use headless_chrome::protocol::cdp::{Emulation, Input, Log, Network, Runtime};
use headless_chrome::{Browser, LaunchOptions, Tab};
use serde_json::{Value, json};
use tempfile::TempDir;

const FLAGS: [&str; 3] =
    ["--headless=new", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"];
const PATIENCE: Duration = Duration::from_secs(240);

/// A report in a browser, and what the browser had to say about it.
struct Page {
    tab: Arc<Tab>,
    /// Errors in the console.
    complaints: Arc<Mutex<Vec<String>>>,
    /// Everything that was asked for.
    requests: Arc<Mutex<Vec<String>>>,
    _browser: Browser,
    _folder: TempDir,
}

impl Page {
    fn open(html: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("report.html");
        std::fs::write(&path, html).unwrap();

        let browser = browser();
        let tab = browser.new_tab().unwrap();
        let complaints = Arc::new(Mutex::new(Vec::new()));
        let requests = Arc::new(Mutex::new(Vec::new()));
        let (complain, request) = (Arc::clone(&complaints), Arc::clone(&requests));
        let listen = move |event: &Event| {
            if let Some(complaint) = complaint(event) {
                complain.lock().unwrap().push(complaint);
            }
            if let Event::NetworkRequestWillBeSent(sent) = event {
                request.lock().unwrap().push(sent.params.request.url.clone());
            }
        };
        tab.add_event_listener(Arc::new(listen)).unwrap();
        tab.set_default_timeout(PATIENCE);
        tab.call_method(Runtime::Enable(None)).unwrap();
        tab.call_method(Log::Enable(None)).unwrap();
        tab.call_method(network()).unwrap();

        let page = Self { tab, complaints, requests, _browser: browser, _folder: folder };
        page.resize(1400, 1000);
        page.tab.navigate_to(&format!("file://{}", path.display())).unwrap();
        page.tab.wait_until_navigated().unwrap();
        page.until("document.readyState === 'complete' && window.Plotly !== undefined");
        page
    }

    fn resize(&self, width: u32, height: u32) {
        let metrics = json!({"width": width, "height": height, "deviceScaleFactor": 1.0,
                             "mobile": false});
        let metrics: Emulation::SetDeviceMetricsOverride = serde_json::from_value(metrics).unwrap();
        self.tab.call_method(metrics).unwrap();
    }

    /// The value of an expression, which may be a promise.
    fn ask(&self, expression: &str) -> Value {
        let asked = format!("(async () => JSON.stringify(await ({expression})) ?? 'null')()");
        let answer = self.tab.evaluate(&asked, true).unwrap();
        let text = answer.value.as_ref().and_then(Value::as_str);
        let text = text.unwrap_or_else(|| panic!("`{expression}` gave {:?}", answer.description));
        serde_json::from_str(text).unwrap()
    }

    fn number(&self, expression: &str) -> f64 {
        self.ask(expression).as_f64().unwrap_or_else(|| panic!("`{expression}` is no number"))
    }

    /// Waits for a condition.
    fn until(&self, condition: &str) {
        let end = (PATIENCE / 4).as_millis(); // well before the browser is given up
        let promise = format!(
            "new Promise((done) => {{ const end = Date.now() + {end}; const look = () => \
             ({condition}) ? done(true) : Date.now() > end ? done(false) : setTimeout(look, 20); \
             look(); }})"
        );
        let came = self.ask(&promise) == true;
        assert!(came, "never came: {condition}; {:#?}", self.complaints.lock().unwrap());
    }

    /// Sets a control as its user would.
    fn set(&self, id: &str, value: &str, event: &str) {
        self.ask(&format!(
            "(() => {{ const control = document.getElementById('{id}'); control.value = \
             '{value}'; control.dispatchEvent(new Event('{event}', {{bubbles: true}})); }})()"
        ));
    }

    fn mouse(&self, kind: &str, at: [f64; 2], buttons: u32) {
        let event = json!({"type": kind, "x": at[0], "y": at[1], "button": "left",
                           "buttons": buttons, "clickCount": 1});
        let event: Input::DispatchMouseEvent = serde_json::from_value(event).unwrap();
        self.tab.call_method(event).unwrap();
    }

    /// Turns a plot with the button for the view from above, back, and then with the mouse.
    fn the_view_turns(&self, plot: &str) {
        let eye = eye(plot);
        self.ask("document.querySelector('[data-view=top]').click()");
        self.until(&format!("{eye}.z > 1.4"));
        self.ask("document.querySelector('[data-view=oblique]').click()");
        self.until(&format!("{eye}.z < 1.0"));
        self.ask(&format!("document.getElementById('{plot}').scrollIntoView({{block: 'center'}})"));
        let place = self.ask(&format!(
            "(() => {{ const box = document.querySelector('#{plot} canvas')\
             .getBoundingClientRect(); return [box.x + box.width / 2, box.y + box.height / 2]; \
             }})()"
        ));
        let [x, y] = [0, 1].map(|axis| place[axis].as_f64().unwrap());
        let before = self.ask(&eye);
        self.mouse("mouseMoved", [x, y], 0);
        self.mouse("mousePressed", [x, y], 1);
        for step in 1..=10 {
            self.mouse("mouseMoved", [x + 12.0 * f64::from(step), y + 3.0 * f64::from(step)], 1);
        }
        self.mouse("mouseReleased", [x + 120.0, y + 30.0], 0);
        self.until(&format!("Math.abs({eye}.x - ({})) > 0.2", before["x"]));
    }

    /// How many colours a plot in space shows.
    fn colours(&self, plot: &str) -> f64 {
        self.number(&format!(
            "(() => {{ const gl = document.querySelector('#{plot} canvas'); const copy = \
             document.createElement('canvas'); [copy.width, copy.height] = [gl.width, gl.height]; \
             const flat = copy.getContext('2d'); document.getElementById('{plot}')._fullLayout\
             .scene._scene.glplot.redraw(); flat.drawImage(gl, 0, 0); return new Set(new \
             Uint32Array(flat.getImageData(0, 0, copy.width, copy.height).data.buffer)).size; }})()"
        ))
    }

    /// Nothing in the console, and nothing asked for that is not here.
    fn nothing_was_wrong(&self) {
        let complaints = self.complaints.lock().unwrap();
        assert!(complaints.is_empty(), "{complaints:#?}");
        let requests = self.requests.lock().unwrap();
        assert!(!requests.is_empty(), "the page itself was asked for");
        let local =
            |url: &&String| ["file:", "data:", "blob:"].iter().any(|is| url.starts_with(is));
        assert_eq!(requests.iter().find(|url| !local(url)), None);
    }
}

/// Where a plot in space is seen from.
fn eye(plot: &str) -> String {
    format!("document.getElementById('{plot}')._fullLayout.scene._scene.getCamera().eye")
}

/// Chromium from the machine; the test fails without.
fn browser() -> Browser {
    let path = default_executable().unwrap_or_else(|_| {
        panic!(
            "no Chromium on this machine, in which the report is tried out: install it with \
             `apt-get install --no-install-recommends chromium`, or set CHROME to its path"
        )
    });
    let options = LaunchOptions::default_builder()
        .path(Some(path))
        .headless(false) // The flag for it is ours.
        .sandbox(false)
        .enable_gpu(true)
        .args(FLAGS.map(OsStr::new).to_vec())
        .idle_browser_timeout(PATIENCE)
        .build();
    Browser::new(options.unwrap()).unwrap()
}

fn network() -> Network::Enable {
    serde_json::from_value(json!({})).unwrap()
}

/// What an event complains of, if it does.
fn complaint(event: &Event) -> Option<String> {
    match event {
        Event::RuntimeExceptionThrown(thrown) => {
            Some(format!("{:?}", thrown.params.exception_details))
        }
        Event::RuntimeConsoleAPICalled(called) => {
            let level = &called.params.Type;
            let bad = matches!(
                level,
                Runtime::ConsoleAPICalledEventTypeOption::Error
                    | Runtime::ConsoleAPICalledEventTypeOption::Assert
            );
            bad.then(|| format!("{:?}", called.params.args))
        }
        Event::LogEntryAdded(added) if added.params.entry.level == Log::LogEntryLevel::Error => {
            Some(added.params.entry.text.clone())
        }
        _ => None,
    }
}
