//! The report as a reader meets it: opened from a file in a headless Chromium, and used.

use std::ffi::OsStr;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use headless_chrome::browser::default_executable;
use headless_chrome::protocol::cdp::types::Event;
use headless_chrome::protocol::cdp::{Emulation, Input, Log, Network, Runtime};
use headless_chrome::{Browser, LaunchOptions, Tab};
use serde_json::{Value, json};
use tempfile::TempDir;

use super::{Report, Scene, example};

const FLAGS: [&str; 3] =
    ["--headless=new", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"];
const PATIENCE: Duration = Duration::from_secs(120);

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

fn report(scene: bool) -> String {
    let evaluation = example::evaluation();
    let scene = scene.then(|| Scene::new(&example::arm(), &example::field(), &evaluation).unwrap());
    let report = Report {
        title: "An example",
        evaluation: &evaluation,
        simulated: true,
        settings_toml: "[estimator]\nmethod = \"map\"\n",
        data: &[("log".to_owned(), "made up".to_owned())],
        scene,
    };
    report.html().unwrap()
}

#[test]
fn the_report_opens_without_a_network_and_answers_its_reader() {
    let page = Page::open(&report(true));
    everything_is_drawn(&page);
    another_touch_changes_the_curves(&page);
    another_method_changes_the_joints(&page);
    a_threshold_hides_soft_points(&page);
    the_arm_moves_with_the_frame(&page);
    the_view_turns(&page);
    nothing_sticks_out_of_a_narrow_window(&page);
    nothing_was_wrong(&page);
}

#[test]
fn a_report_without_a_scene_shows_the_rest() {
    let page = Page::open(&report(false));
    page.until("document.querySelectorAll('#error .scatterlayer .trace').length === 4");
    assert_eq!(page.ask("document.getElementById('scene')"), Value::Null);
    page.set("touch", "2", "change");
    page.until("document.querySelectorAll('#joint-6 .trace').length === 2");
    nothing_was_wrong(&page);
}

const DRAWN: &str = "document.querySelectorAll('#error .scatterlayer .trace').length === 4 && \
                     document.querySelector('#scene canvas') !== null && \
                     document.getElementById('scene')._fullLayout?.scene?._scene?.glplot != null";

/// Every plot has its curves; zero's error is the torque itself, one curve for both.
fn everything_is_drawn(page: &Page) {
    page.until(DRAWN);
    for joint in 0..7 {
        page.until(&format!("document.querySelectorAll('#joint-{joint} .trace').length === 2"));
    }
    page.until("document.querySelectorAll('#contacts .trace').length === 2");
    let pixels = "(() => { const gl = document.querySelector('#scene canvas'); const copy = \
                  document.createElement('canvas'); [copy.width, copy.height] = [gl.width, \
                  gl.height]; const flat = copy.getContext('2d'); document.getElementById(\
                  'scene')._fullLayout.scene._scene.glplot.redraw(); flat.drawImage(gl, 0, 0); \
                  return new Set(new Uint32Array(flat.getImageData(0, 0, copy.width, \
                  copy.height).data.buffer)).size; })()";
    let colours = page.number(pixels);
    assert!(colours > 50.0, "the scene shows {colours} colours");
    assert_eq!(page.number("document.querySelectorAll('tbody tr').length"), 4.0);
    let text = page.ask("document.body.innerText");
    let text = text.as_str().unwrap();
    for sentence in ["The touches are simulated.", "map: average relative error 0.30 ± 0.00; best"]
    {
        assert!(text.contains(sentence), "{sentence}");
    }
}

fn another_touch_changes_the_curves(page: &Page) {
    let curve = "Array.from(document.getElementById('error').data[1].y)";
    let before = page.ask(curve);
    page.set("touch", "1", "change");
    assert_ne!(page.ask(curve), before);
    let external = &example::evaluation().touches[1].external[100];
    let error = 0.3 * external.iter().map(|tau| tau * tau).sum::<f64>().sqrt();
    let drawn = page.number("document.getElementById('error').data[1].y[100]");
    assert!((drawn - error).abs() < 2e-3, "{drawn} N·m drawn for {error}");
}

fn another_method_changes_the_joints(page: &Page) {
    page.set("method", "1", "change");
    assert_eq!(page.ask("document.getElementById('joint-0').data[1].name"), "gp");
    assert_eq!(page.ask("document.getElementById('contacts').data[1].name"), "error of gp");
}

fn a_threshold_hides_soft_points(page: &Page) {
    let points = "document.getElementById('scene').data[1].x.length";
    page.set("threshold", "0", "input");
    let all = example::field().cells.len();
    page.until(&format!("{points} === {all}"));
    page.set("threshold", "60", "input");
    page.until(&format!("{points} < {all} && {points} > 0"));
    let softest = page.number("Math.min(...document.getElementById('scene').data[1].customdata)");
    let stiffest = example::field().stiffness_n_per_m.into_iter().fold(0.0, f64::max);
    assert!(softest >= 0.099 * stiffest, "{softest} N/m is shown"); // a decade, 40 % of 2.5
    let told = page.ask("document.getElementById('threshold-shown').textContent");
    let shown = page.number(points);
    assert!(told.as_str().unwrap().contains(&format!("({shown} shown)")), "{told}");
}

fn the_arm_moves_with_the_frame(page: &Page) {
    let vertices = "Array.from(document.getElementById('scene').data[0].x)";
    page.set("frame", "0", "input");
    page.until("document.getElementById('frame-shown').textContent.includes('frame 0')");
    page.until("document.getElementById('error').layout.shapes[0].x0 === 0");
    let at_rest = page.ask(vertices);
    page.set("frame", "120", "input");
    page.until("document.getElementById('error').layout.shapes[0].x0 > 5");
    assert_ne!(page.ask(vertices), at_rest);

    // A vertex of the last link stands where the kinematics say.
    let (arm, evaluation) = (example::arm(), example::evaluation());
    let scene = Scene::new(&arm, &example::field(), &evaluation).unwrap();
    let (hull, last) = (scene.hulls.last().unwrap(), scene.hulls.len() - 1);
    let vertex = scene.poses[1][120][last] * hull.vertices_m.last().unwrap();
    for (axis, along) in ["x", "y", "z"].into_iter().enumerate() {
        let shown =
            page.number(&format!("document.getElementById('scene').data[0].{along}.at(-1)"));
        assert!((shown - vertex[axis]).abs() < 5e-4, "{along}: {shown} for {}", vertex[axis]);
    }
}

fn the_view_turns(page: &Page) {
    let eye = "document.getElementById('scene')._fullLayout.scene._scene.getCamera().eye";
    page.ask("document.getElementById('scene').scrollIntoView({block: 'center'})");
    let place = page.ask(
        "(() => { const box = document.querySelector('#scene canvas').getBoundingClientRect(); \
         return [box.x + box.width / 2, box.y + box.height / 2]; })()",
    );
    let [x, y] = [0, 1].map(|axis| place[axis].as_f64().unwrap());
    let before = page.ask(eye);
    page.mouse("mouseMoved", [x, y], 0);
    page.mouse("mousePressed", [x, y], 1);
    for step in 1..=10 {
        page.mouse("mouseMoved", [x + 12.0 * f64::from(step), y + 3.0 * f64::from(step)], 1);
    }
    page.mouse("mouseReleased", [x + 120.0, y + 30.0], 0);
    page.until(&format!("Math.abs({eye}.x - ({})) > 0.05", before["x"]));

    page.ask("document.querySelector('[data-view=top]').click()");
    page.until(&format!("{eye}.z > 1.5"));
}

fn nothing_sticks_out_of_a_narrow_window(page: &Page) {
    page.resize(400, 900);
    page.until("document.querySelector('#error .main-svg').getBoundingClientRect().width < 400");
    page.until("document.documentElement.scrollWidth <= 400");
    page.until("document.querySelector('#scene canvas').getBoundingClientRect().width < 400");
}

fn nothing_was_wrong(page: &Page) {
    let complaints = page.complaints.lock().unwrap();
    assert!(complaints.is_empty(), "{complaints:#?}");
    let requests = page.requests.lock().unwrap();
    assert!(!requests.is_empty(), "the page itself was asked for");
    let local = |url: &&String| ["file:", "data:", "blob:"].iter().any(|is| url.starts_with(is));
    assert_eq!(requests.iter().find(|url| !local(url)), None);
}
