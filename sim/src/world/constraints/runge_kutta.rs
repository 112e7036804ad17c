//! MuJoCo's Runge-Kutta integrator: a step computes all forces four times.

use rapier3d::prelude::PhysicsWorld;

use super::matrix::add_scaled;
use super::motion::Motion;
use super::{Constraints, HingeDrives};
use crate::robot::Robot;

/// Weights of the four stages in the step, and the part of the step from its start to the next stage.
const STAGES: [(f64, Option<f64>); 4] =
    [(1.0 / 6.0, Some(0.5)), (1.0 / 3.0, Some(0.5)), (1.0 / 3.0, Some(1.0)), (1.0 / 6.0, None)];

/// Memory for a step.
#[derive(Default)]
pub(super) struct RungeKutta {
    /// The motion at the start of the step.
    pub(super) start: Motion,
    /// Velocities of the stage.
    speeds: Vec<f64>,
    /// Velocities with which the robot moves to the next stage, then in the step.
    moving: Vec<f64>,
    mean_speeds: Vec<f64>,
    /// Mean accelerations of the step.
    mean_changes: Vec<f64>,
}

impl Constraints {
    /// Makes a step from accelerations that the step has computed at its start. Returns whether the motion is finite.
    pub(super) fn finish_runge_kutta(
        &mut self,
        robot: &Robot,
        drives: &mut HingeDrives,
        physics: &mut PhysicsWorld,
    ) -> bool {
        let (layout, step_secs) = (&robot.layout, self.step_secs);
        let mut stages = std::mem::take(&mut self.stages);
        std::mem::swap(&mut self.start, &mut stages.start);
        let RungeKutta { start, speeds, moving, mean_speeds, mean_changes } = &mut stages;
        speeds.clone_from(&start.speeds);
        for sum in [&mut *mean_speeds, &mut *mean_changes] {
            sum.clear();
            sum.resize(speeds.len(), 0.0);
        }
        let mut is_finite = true;
        for (weight, part) in STAGES {
            add_scaled(mean_speeds, weight, speeds);
            add_scaled(mean_changes, weight, &self.change);
            drives.advance(weight as f32, part.map(|part| part as f32));
            let Some(part) = part else { break };
            moving.clear();
            moving.extend(speeds.iter().map(|speed| part * speed));
            speeds.clone_from(&start.speeds);
            add_scaled(speeds, part * step_secs, &self.change);
            is_finite = is_finite && self.go(robot, physics, start, [moving, speeds]);
            if !is_finite {
                break;
            }
            let multibody = layout.robot_in_mut(&mut physics.multibody_joints);
            drives.apply_stage(multibody, &layout.hinges);
            is_finite = self.accelerate(robot, drives, physics);
        }
        speeds.clone_from(&start.speeds);
        add_scaled(speeds, step_secs, mean_changes);
        let is_finite = is_finite && self.go(robot, physics, start, [mean_speeds, speeds]);
        self.stages = stages;
        is_finite
    }
}
