//! One joint, one contact, one spring: the whole method on a case with an answer on paper.
//!
//! A hinge about z carries a rod. The rod has pushed the point (0.5, 0, 0) m sideways by 4 cm and
//! the joint feels 3 N·m. The point's lever is 0.5 m × 0.04 m = 0.02 m², so its spring must have
//! 3 / 0.02 = 150 N/m.

use nalgebra::{DVector, Point3, Vector3};
use palpate::unstable::{
    CellRows, Estimator, FrameId, LinkContacts, LinkId, MapEstimator, Observation, lever,
};
use palpate::{Contacts, EstimatorConfig, EstimatorKind, Lattice, Prior, Robot};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    // The robot is a URDF; its links need no shapes here, since the contact is given below.
    let robot = Robot::from_urdf(
        "<robot name='hinge'><link name='base'/><link name='rod'/>
           <joint name='hinge' type='continuous'>
             <parent link='base'/><child link='rod'/><axis xyz='0 0 1'/>
           </joint></robot>",
    )?;
    let rod = LinkId(1);
    let poses = robot.forward(&[0.0])?;

    // The world: 1 cm cells. One of them is pushed by u = (0, -4, 0) cm.
    let mut rows = CellRows::new(Lattice::new([0.0, -0.2, 0.0], 0.01, [80, 40, 1])?);
    let rest = Point3::new(0.5, 0.0, 0.0);
    let cell = rows.lattice().nearest(&rest).ok_or("outside the lattice")?;
    let u = Vector3::new(0.0, -0.04, 0.0);
    println!("lever       {:.3} m²", lever(&robot, &poses, rod, &rest, &u)[0]);
    let contacts = Contacts {
        links: vec![LinkContacts {
            link: rod,
            cells: vec![cell],
            displacements_m: vec![u.cast::<f32>().into()],
        }],
    };

    // The torque that was measured, and the estimator that explains it: a vague prior, a precise sensor.
    let tau = DVector::from_element(1, 3.0);
    let frame = Observation::new(&robot, &poses, &contacts, &mut rows, &tau);
    let mut settings = EstimatorConfig::of(EstimatorKind::Map);
    settings.prior = Prior { mean_n_per_m: 0.0, std_n_per_m: 1000.0 };
    settings.torque_std = vec![0.01];
    let mut map = MapEstimator::new(&settings, rows.lattice().spacing_m(), robot.n_joints())?;
    map.correct(rows.points_m(), frame, FrameId { touch: 0, sample: 0 })?;

    let row = rows.find(cell).ok_or("the cell was touched")? as usize;
    println!("stiffness   {:.1} ± {:.1} N/m", map.stiffness(row), map.std(row));
    assert!((map.stiffness(row) - 150.0).abs() < 0.1);
    Ok(())
}
