//! Tests of the pages as a reader uses them: opened from a file in a headless Chromium.

mod chromium;
mod extrapolation;
mod report;

use std::time::Duration;

use serde_json::{Value, json};
use tempfile::TempDir;

use self::chromium::{Chromium, PATIENCE};

/// A report in a browser.
struct Page {
    tab: Chromium,
    _folder: TempDir,
}

impl Page {
    fn open(html: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("report.html");
        std::fs::write(&path, html).unwrap();

        let tab = Chromium::open();
        for events in ["Runtime", "Log", "Network"] {
            tab.call(&format!("{events}.enable"), &json!({}));
        }
        let page = Self { tab, _folder: folder };
        page.resize(1400, 1000);
        page.tab.navigate(&format!("file://{}", path.display()));
        page.until("document.readyState === 'complete' && window.Plotly !== undefined");
        page
    }

    fn resize(&self, width: u32, height: u32) {
        let metrics = json!({"width": width, "height": height, "deviceScaleFactor": 1.0,
                             "mobile": false});
        self.tab.call("Emulation.setDeviceMetricsOverride", &metrics);
    }

    /// The value of an expression, which may be a promise.
    fn ask(&self, expression: &str) -> Value {
        let asked = format!("(async () => JSON.stringify(await ({expression})) ?? 'null')()");
        let asked = json!({"expression": asked, "awaitPromise": true});
        let answer = self.tab.call("Runtime.evaluate", &asked);
        let text = answer["result"]["value"].as_str();
        serde_json::from_str(text.unwrap_or_else(|| panic!("`{expression}` gave {answer}")))
            .unwrap()
    }

    fn number(&self, expression: &str) -> f64 {
        self.ask(expression).as_f64().unwrap_or_else(|| panic!("`{expression}` is no number"))
    }

    /// Waits for a condition.
    fn until(&self, condition: &str) {
        let came = self.comes(condition, PATIENCE / 4); // well before the browser is given up
        assert!(came, "never came: {condition}; {:#?}", self.complaints());
    }

    /// Whether a condition becomes true within a time.
    fn comes(&self, condition: &str, within: Duration) -> bool {
        let end = within.as_millis();
        let promise = format!(
            "new Promise((done) => {{ const end = Date.now() + {end}; const look = () => \
             ({condition}) ? done(true) : Date.now() > end ? done(false) : setTimeout(look, 20); \
             look(); }})"
        );
        self.ask(&promise) == true
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
        self.tab.call("Input.dispatchMouseEvent", &event);
    }

    /// Turns a plot with the button for the view from above, back, and then with the mouse.
    fn the_view_turns(&self, plot: &str) {
        let eye = eye(plot);
        self.ask("document.querySelector('[data-view=top]').click()");
        self.until(&format!("{eye}.z > 1.4"));
        self.ask("document.querySelector('[data-view=oblique]').click()");
        self.until(&format!("{eye}.z < 1.0"));
        // On a busy machine the page may still move, and the motion that the buttons started may end only
        // now and reset the view, in the other plot too.
        let place = format!(
            "(() => {{ const canvas = document.querySelector('#{plot} canvas'); \
             canvas.scrollIntoView({{block: 'center', behavior: 'instant'}}); \
             const box = canvas.getBoundingClientRect(); \
             return [box.x + box.width / 2, box.y + box.height / 2]; }})()"
        );
        let turned = (0..16).any(|_| {
            self.ask(
                "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))",
            );
            let (before, at) = (self.ask(&eye), self.ask(&place));
            let [x, y] = [0, 1].map(|axis| at[axis].as_f64().unwrap());
            self.mouse("mouseMoved", [x, y], 0);
            self.mouse("mousePressed", [x, y], 1);
            for step in 1..=10 {
                let along = f64::from(step);
                self.mouse("mouseMoved", [x + 12.0 * along, y + 3.0 * along], 1);
            }
            self.mouse("mouseReleased", [x + 120.0, y + 30.0], 0);
            self.comes(&format!("Math.abs({eye}.x - ({})) > 0.2", before["x"]), PATIENCE / 16)
        });
        let there = self.ask(&format!(
            "(([x, y]) => [x, y, innerWidth, innerHeight, document.elementFromPoint(x, y)?.outerHTML\
             .slice(0, 200)])({place})"
        ));
        assert!(turned, "the mouse never turned {plot}, at {there}; {:#?}", self.complaints());
    }

    /// Number of colours that a 3-D plot shows.
    fn colours(&self, plot: &str) -> f64 {
        self.number(&format!(
            "(() => {{ const gl = document.querySelector('#{plot} canvas'); const copy = \
             document.createElement('canvas'); [copy.width, copy.height] = [gl.width, gl.height]; \
             const flat = copy.getContext('2d'); document.getElementById('{plot}')._fullLayout\
             .scene._scene.glplot.redraw(); flat.drawImage(gl, 0, 0); return new Set(new \
             Uint32Array(flat.getImageData(0, 0, copy.width, copy.height).data.buffer)).size; }})()"
        ))
    }

    /// Errors in the console.
    fn complaints(&self) -> Vec<String> {
        self.tab.events(complaint)
    }

    /// Asserts that the console has no errors and that only local files were requested.
    fn nothing_was_wrong(&self) {
        let complaints = self.complaints();
        assert!(complaints.is_empty(), "{complaints:#?}");
        let requests: Vec<String> = self.tab.events(|event, of| {
            let url =
                of["request"]["url"].as_str().filter(|_| event == "Network.requestWillBeSent");
            url.map(str::to_owned)
        });
        assert!(!requests.is_empty(), "the page itself was asked for");
        let local =
            |url: &&String| ["file:", "data:", "blob:"].iter().any(|is| url.starts_with(is));
        assert_eq!(requests.iter().find(|url| !local(url)), None);
    }
}

/// The expression for the eye of a 3-D plot.
fn eye(plot: &str) -> String {
    format!("document.getElementById('{plot}')._fullLayout.scene._scene.getCamera().eye")
}

/// The error that an event reports, if any.
fn complaint(event: &str, of: &Value) -> Option<String> {
    match event {
        "Runtime.exceptionThrown" => Some(of["exceptionDetails"].to_string()),
        "Runtime.consoleAPICalled" => {
            let bad = of["type"] == "error" || of["type"] == "assert";
            bad.then(|| of["args"].to_string())
        }
        "Log.entryAdded" if of["entry"]["level"] == "error" => {
            Some(of["entry"]["text"].to_string())
        }
        _ => None,
    }
}
