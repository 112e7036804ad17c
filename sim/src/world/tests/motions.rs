//! Motions of bodies and contacts, beside those that MuJoCo 4.0.0 has for the same models.

use super::{assert_near, motion, world_of};

/// A motion from rest.
struct Case {
    /// What it shows.
    name: &'static str,
    /// Sections before the bodies.
    sections: &'static str,
    bodies: &'static str,
    /// Coordinates at the start.
    start: &'static [f32],
    /// Steps of a millisecond.
    steps: usize,
    /// MuJoCo's coordinates after them.
    end: &'static [f32],
}

const CASES: &[Case] = &[
    Case {
        name: "a capsule that stands on a box",
        sections: "",
        bodies: "<geom type=\"box\" size=\".15 .15 .1\"/><body pos=\"0 0 .199\"><joint type=\"slide\" axis=\"0 0 1\"/><geom type=\"capsule\" size=\".05\" fromto=\"0 0 .05 0 0 -.05\"/></body>",
        start: &[0.0],
        steps: 200,
        end: &[0.000633],
    },
    Case {
        name: "parallel capsules, shifted",
        sections: "",
        bodies: "<geom type=\"capsule\" size=\".05 .1\"/><body pos=\".098 0 .01\"><joint axis=\"0 1 0\"/><joint type=\"slide\" axis=\"1 0 0\"/><geom type=\"capsule\" size=\".05 .1\"/></body>",
        start: &[0.0, 0.0],
        steps: 200,
        end: &[0.067177, 0.008603],
    },
    Case {
        name: "parallel capsules of two lengths",
        sections: "",
        bodies: "<geom type=\"capsule\" size=\".05 .1\"/><body pos=\".098 0 .01\"><joint axis=\"0 1 0\"/><joint type=\"slide\" axis=\"1 0 0\"/><geom type=\"capsule\" size=\".05 .06\"/></body>",
        start: &[0.0, 0.0],
        steps: 200,
        end: &[0.126875, 0.009624],
    },
    Case {
        name: "a stated inertia without shapes",
        sections: "<compiler inertiafromgeom=\"true\"/>",
        bodies: "<body pos=\"0 0 1\"><joint axis=\"0 1 0\"/><geom size=\".1\" pos=\".1 0 0\"/><body pos=\".3 0 0\"><inertial pos=\".1 0 0\" mass=\"2\" diaginertia=\".1 .1 .1\"/></body></body>",
        start: &[0.2],
        steps: 200,
        end: &[0.680215],
    },
    Case {
        name: "a body without a mass in a frame",
        sections: "<compiler boundmass=\"2\"/>",
        bodies: "<body pos=\"0 0 1\"><joint axis=\"0 1 0\"/><geom size=\".1\" pos=\".1 0 0\"/><frame pos=\".3 0 0\"><body name=\"b2\"/></frame></body>",
        start: &[0.2],
        steps: 200,
        end: &[0.98535],
    },
    Case {
        name: "a slide with a position",
        sections: "<equality><weld body1=\"b1\"/></equality>",
        bodies: "<body name=\"b1\" pos=\"0 0 1\"><joint type=\"slide\" axis=\"0 0 1\" pos=\".1 0 0\"/><geom size=\".1\"/></body>",
        start: &[0.2],
        steps: 40,
        end: &[0.078386],
    },
    Case {
        name: "a limited slide with armature",
        sections: "",
        bodies: "<body><joint type=\"slide\" armature=\"5\" range=\"-.01 .01\"/><geom size=\".1\"/></body>",
        start: &[0.03],
        steps: 100,
        end: &[-0.014957],
    },
    Case {
        name: "two slides of one body with armature",
        sections: "",
        bodies: "<body><joint type=\"slide\" axis=\"1 0 0\" armature=\"5\" range=\"-.01 .01\"/><joint type=\"slide\" armature=\"5\" range=\"-.01 .01\"/><geom size=\".1\"/></body>",
        start: &[0.03, 0.03],
        steps: 100,
        end: &[-0.004843, -0.014957],
    },
    Case {
        name: "a sprung slide with armature",
        sections: "",
        bodies: "<body><joint type=\"slide\" armature=\"5\" springdamper=\".2 1\"/><geom size=\".1\"/></body>",
        start: &[0.05],
        steps: 200,
        end: &[-0.023597],
    },
    Case {
        name: "a ball whose centre is on a plane",
        sections: "",
        bodies: "<geom type=\"plane\" size=\"1 1 1\"/><body><joint type=\"slide\" axis=\"0 0 1\"/><joint type=\"slide\" axis=\"1 0 0\"/><geom size=\".1\"/></body>",
        start: &[0.0, 0.0],
        steps: 100,
        end: &[0.144616, 0.0],
    },
];

#[test]
fn bodies_and_contacts_move_as_in_mujoco() {
    for Case { name, sections, bodies, start, steps, end } in CASES {
        let mut world = world_of(&format!(
            "<mujoco><option timestep=\".001\"/>{sections}<worldbody>{bodies}</worldbody></mujoco>"
        ));
        world.rebuild(start, &vec![0.0; start.len()]);
        for _ in 0..*steps {
            assert!(world.step(&[]), "{name}");
        }
        assert_near(name, &motion(&world).0, end, 1e-4);
    }
}
