//! The arm, its controller and the simulated plant: against references, against
//! conservation laws, and together on spheres.

mod approaches;
mod campaign;
mod commission;
mod contact;
mod faults;
mod injected;
mod killed;
mod late_drive;
mod law;
mod placements;
mod plant;
mod plant_drops;
mod plant_elastic;
mod plant_friction;
mod plant_nest;
mod plant_presets;
mod plant_rig;
mod pressing;
mod pushes;
mod recovery;
mod robot_oracle;
mod second_visits;
mod teach;
