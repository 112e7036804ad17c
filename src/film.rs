//! Episodes and pictures of robots: film strips, portraits with numbered joints, and what an episode measures. Every
//! link has the colour of the agent that drives it.

mod camera;
mod captions;
mod drawing;
mod episode;
mod joints;
mod measures;
mod portrait;
mod shapes;
mod sheet;
mod solids;
mod strip;

pub(crate) use episode::PlayedEpisode;
pub(crate) use joints::distinct_joints;
pub(crate) use portrait::portrait;
pub(crate) use shapes::RobotShapes;
pub(crate) use strip::{Frame, strip};

#[cfg(test)]
mod tests;
