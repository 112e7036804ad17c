//! Bounds of the numbers that attributes state: no simulation in single precision survives numbers beyond them.

use crate::error::short;

/// Numbers that some attributes may have, both ends included.
struct Bounds {
    attributes: &'static [&'static str],
    low: f64,
    high: f64,
    /// Smallest magnitude of a number that is not 0.
    smallest: f64,
    unit: &'static str,
}

/// Largest number of an attribute without an entry of its own, in its unit.
const LARGEST: f64 = 1e9;

const fn row(attributes: &'static [&'static str], [low, high]: [f64; 2]) -> Bounds {
    Bounds { attributes, low, high, smallest: 0.0, unit: "" }
}

const ALL: [Bounds; 23] = [
    Bounds { unit: " s", ..row(&["timestep"], [1e-5, 0.1]) },
    Bounds { unit: " m/s^2", ..row(&["gravity"], [-1e4, 1e4]) },
    Bounds { unit: " m", ..row(&["pos", "refpos", "fromto", "anchor", "vertex"], [-1e4, 1e4]) },
    Bounds { unit: " m", smallest: 1e-6, ..row(&["size"], [0.0, 1e4]) },
    Bounds { unit: " m", ..row(&["margin"], [0.0, 10.0]) },
    Bounds { unit: " kg", smallest: 1e-12, ..row(&["mass"], [0.0, 1e9]) },
    Bounds { unit: " kg", smallest: 1e-9, ..row(&["settotalmass"], [-1e9, 1e9]) },
    Bounds { unit: " kg/m^3", smallest: 1e-9, ..row(&["density"], [0.0, 1e9]) },
    Bounds { unit: " Pa s", ..row(&["viscosity"], [0.0, 1e6]) },
    Bounds { unit: " m/s", ..row(&["wind"], [-1e3, 1e3]) },
    row(&["fitscale"], [1e-6, 1e6]),
    Bounds { unit: " kg m^2", smallest: 1e-15, ..row(&["diaginertia"], [0.0, 1e12]) },
    row(&["boundmass", "boundinertia", "inheritrange", "solmix"], [0.0, 1e9]),
    row(
        &["axis", "quat", "refquat", "axisangle", "euler", "xyaxes", "zaxis", "scale"],
        [-1e6, 1e6],
    ),
    row(&["range", "ref", "springref", "springlength"], [-1e6, 1e6]),
    row(&["stiffness", "damping", "armature", "frictionloss", "dampratio"], [0.0, 1e12]),
    Bounds { smallest: 1e-6, ..row(&["solref", "solreflimit", "solreffriction"], [-1e9, 1e9]) },
    row(&["solimp", "solimplimit", "solimpfriction", "friction"], [0.0, 1e6]),
    row(&["impratio"], [1e-6, 1e6]),
    row(&["relpose", "torquescale"], [-1e4, 1e4]),
    Bounds { smallest: 1e-6, ..row(&["springdamper", "timeconst"], [0.0, 1e6]) },
    row(&["gravcomp"], [0.0, 1e3]),
    Bounds { smallest: 1e-9, ..row(&["gear", "coef", "kp", "kv"], [-LARGEST, LARGEST]) },
];

/// Why an attribute must not have a number, if it must not.
pub(in crate::robot) fn refusal(attribute: &str, number: f64) -> Option<String> {
    let own = ALL.iter().find(|row| row.attributes.contains(&attribute));
    let any = row(&[], [-LARGEST, LARGEST]);
    let Bounds { low, high, smallest, unit, .. } = own.unwrap_or(&any);
    let is_small = number != 0.0 && number.abs() < *smallest;
    if (*low..=*high).contains(&number) && !is_small {
        return None;
    }
    let least = if is_small {
        format!(" and be 0 or at least {} from it", short(*smallest))
    } else {
        String::new()
    };
    let [low, high, number] = [*low, *high, number].map(short);
    Some(format!("must lie in {low}..={high}{unit}{least}, is {number}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_beyond_the_bounds_of_its_attribute_is_refused_with_the_range_and_the_unit() {
        let refused = |attribute, number: f64| refusal(attribute, number).unwrap();
        assert_eq!(refused("timestep", 1e-300), "must lie in 1e-5..=0.1 s, is 1e-300");
        assert_eq!(refused("pos", -2e4), "must lie in -10000..=10000 m, is -20000");
        let mass = "must lie in 0..=1e9 kg and be 0 or at least 1e-12 from it, is 1e-44";
        assert_eq!(refused("mass", 1e-44), mass);
        let gear = "must lie in -1e9..=1e9 and be 0 or at least 1e-9 from it, is -1e-12";
        assert_eq!(refused("gear", -1e-12), gear);
        assert_eq!(refused("ctrlrange", 2e9), "must lie in -1e9..=1e9, is 2e9");
        for (attribute, number) in [("mass", 0.0), ("gear", -1e-9), ("range", 1e6), ("qpos", -1e9)]
        {
            assert_eq!(refusal(attribute, number), None, "{attribute}");
        }
    }
}
