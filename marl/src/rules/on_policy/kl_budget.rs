//! Limit of the joint divergence of all agents' policies in one update.

/// The remaining joint `KL[old || new]`, a sum over agents, and the number of remaining agents. Later agents can use
/// what an agent leaves.
pub(crate) struct KlBudget {
    /// Nats; infinite without a limit.
    left: f64,
    agents: usize,
}

impl KlBudget {
    /// `target_kl` nats for `agents` agents; 0: no limit.
    pub(crate) fn new(target_kl: f64, agents: usize) -> Self {
        Self { left: if target_kl > 0.0 { target_kl } else { f64::INFINITY }, agents }
    }

    /// Limit for the next agent, nats: an equal share of the remainder.
    pub(crate) fn share(&self) -> f64 {
        self.left / self.agents as f64
    }

    /// Subtracts the `kl` nats of the next agent.
    pub(crate) fn spend(&mut self, kl: f64) {
        self.left = (self.left - kl).max(0.0);
        self.agents -= 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn later_agents_can_use_what_an_agent_leaves() {
        let mut budget = KlBudget::new(0.06, 3);
        assert!((budget.share() - 0.02).abs() < 1e-15);
        budget.spend(0.01);
        assert!((budget.share() - 0.025).abs() < 1e-15);
        budget.spend(0.07);
        assert_eq!(budget.share(), 0.0);
    }

    #[test]
    fn without_a_target_there_is_no_limit() {
        let mut budget = KlBudget::new(0.0, 2);
        budget.spend(1e9);
        assert_eq!(budget.share(), f64::INFINITY);
    }
}
