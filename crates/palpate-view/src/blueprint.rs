//! Layout of the viewer: its views, legends and explanations.

use re_sdk::blueprint::{
    Blueprint, BlueprintPanel, ContainerLike, Grid, Horizontal, SelectionPanel, Spatial3DView,
    Tabs, TextDocumentView, TextLogView, TimePanel, TimeSeriesView, Vertical,
};
use re_sdk::log::{Chunk, LogMsg};
use re_sdk::{RecordingStream, RecordingStreamBuilder, RecordingStreamError, StoreKind};
use re_sdk_types::blueprint::archetypes::{PlotLegend, ViewBlueprint};
use re_sdk_types::blueprint::components::{Corner2D, PanelState, ViewClass, ViewOrigin};

use crate::camera;
use crate::recording::{APPLICATION, Scene, part};
use crate::view_model::Scale;

/// Name of the timeline of the clock.
pub(crate) const TIME: &str = "time";
/// Name of the timeline of sample numbers.
pub(crate) const SAMPLE: &str = "sample";

/// Entity of the norms of the torques.
const NORM: &str = "torque/norm";

/// With more joints than these, their plots have two columns, and three.
const COLUMNS: [usize; 2] = [3, 12];

/// Sends the layout of a recording, with the camera directed at the arm and legends out of the way.
///
/// Rerun's builder of layouts cannot set cameras and legends, which are properties of views. So the
/// messages of the builder are captured, and messages with these properties are inserted before the
/// last one, which activates the layout.
pub(crate) fn send(scene: &Scene, stream: &RecordingStream) -> Result<(), RecordingStreamError> {
    let builder = RecordingStreamBuilder::new(APPLICATION).enabled(true);
    let (_built, messages) = builder.with_blueprint(layout(scene)).memory()?;
    let mut layout: Vec<LogMsg> = messages.take();
    layout.retain(|message| message.store_id().kind() == StoreKind::Blueprint);
    let Some(LogMsg::BlueprintActivationCommand(activation)) = layout.pop() else {
        return Ok(()); // No activation: the viewer chooses its own layout.
    };
    let more = RecordingStreamBuilder::from_store_id(&activation.blueprint_id);
    let (more, messages) = more.enabled(true).send_properties(false).memory()?;
    more.set_log_tick_enabled(false);
    more.set_log_time_enabled(false);
    more.set_time_sequence("blueprint", 0);
    for view in layout.iter().filter_map(View::made_by) {
        view.log_properties(scene, &more)?;
    }
    let properties = messages.take();
    layout.extend(properties.into_iter().filter(|message| matches!(message, LogMsg::ArrowMsg(..))));
    stream.send_blueprint(layout, activation);
    Ok(())
}

/// A view created by the builder.
struct View {
    path: String,
    class: String,
    origin: String,
}

impl View {
    /// The view that a message creates, if it creates one.
    fn made_by(message: &LogMsg) -> Option<Self> {
        let LogMsg::ArrowMsg(_, message) = message else { return None };
        let chunk = Chunk::from_arrow_msg(message).ok()?;
        let class = ViewBlueprint::descriptor_class_identifier().component;
        let class = chunk.iter_component::<ViewClass>(class).next()?.first()?.0.to_string();
        let origin = ViewBlueprint::descriptor_space_origin().component;
        let origin = chunk.iter_component::<ViewOrigin>(origin).next()?.first()?.0.0.to_string();
        Some(Self { path: chunk.entity_path().to_string(), class, origin })
    }

    fn log_properties(
        &self,
        scene: &Scene,
        stream: &RecordingStream,
    ) -> Result<(), RecordingStreamError> {
        let Self { path, class, origin } = self;
        match class.as_str() {
            "3D" => match camera::eye(scene) {
                Some(eye) => stream.log(format!("{path}/EyeControls3D"), &eye),
                None => Ok(()),
            },
            // One legend is enough. Top right is free, since torques are small at the end of a
            // touch.
            "TimeSeries" => {
                let shown = origin.ends_with(NORM);
                let legend = PlotLegend::new().with_visible(shown);
                let legend = legend.with_corner(Corner2D::RightTop);
                stream.log(format!("{path}/PlotLegend"), &legend)
            }
            _ => Ok(()),
        }
    }
}

/// The arm and the field on the left with explanations below; the torques on the right.
fn layout(scene: &Scene) -> Blueprint {
    let space = Spatial3DView::new("Arm, contacts, field [m]").with_origin("world");
    let mut words: Vec<ContainerLike> = vec![
        TextDocumentView::new("What this is").with_origin("about").into(),
        TextDocumentView::new("Colours").with_origin("colours").into(),
    ];
    if scene.torques {
        words.push(TextLogView::new("Touches").with_origin("touches").into());
    }
    let left = Vertical::new([space.into(), Tabs::new(words).into()]).with_row_shares([4.0, 1.0]);
    let root: ContainerLike = if scene.torques {
        let both = Horizontal::new([left.into(), torques(scene).into()]);
        both.with_column_shares([3.0, 2.0]).into()
    } else {
        left.into()
    };
    let timeline = if scene.clock { TIME } else { SAMPLE };
    Blueprint::new(root)
        .with_auto_views(false)
        .with_auto_layout(false)
        .with_blueprint_panel(BlueprintPanel::from_state(PanelState::Collapsed))
        .with_selection_panel(SelectionPanel::from_state(PanelState::Collapsed))
        .with_time_panel(TimePanel::new().with_timeline(timeline).with_state(PanelState::Collapsed))
}

/// The plot of the norm above, one plot for each joint below.
fn torques(scene: &Scene) -> Vertical {
    let norm = TimeSeriesView::new("Torque over all joints [N·m]").with_origin(NORM);
    let joint = |joint: &String| {
        let view = TimeSeriesView::new(format!("{joint} [N·m]"));
        view.with_origin(format!("torque/{}", part(joint))).into()
    };
    let columns = 1 + COLUMNS.iter().filter(|&&more| scene.joints.len() > more).count();
    let joints = Grid::new(scene.joints.iter().map(joint)).with_grid_columns(columns as u32);
    Vertical::new([norm.into(), joints.into()]).with_row_shares([1.0, 2.0])
}

/// The explanation of the colours of the field, in Markdown.
pub(crate) fn colours(scale: &Scale) -> String {
    let [low, high] = scale.ends_n_per_m();
    let middle = (low * high).sqrt();
    format!(
        "Stiffness of a cell, by colour and size of its ball: **yellow** {high:.3} N/m and more, \
         **green** about {middle:.3} N/m, **violet** {low:.3} N/m. Softer cells are not drawn."
    )
}
