//! The learner: it leases slots of environment steps to actors, trains on the results, and writes the run folder.
//!
//! Its layers, each of which uses only those after it: [`serve`] receives messages and shows the page, [`train`] has the
//! loop that shows the whole data flow, [`lease`] gives out work and takes results in, [`observe`] reports, and [`store`]
//! writes to disk. The learner never steps a world.

pub mod config;
pub mod error;
pub mod launch;
pub mod lease;
pub mod observe;
pub mod run;
pub mod serve;
pub mod store;
pub mod train;
