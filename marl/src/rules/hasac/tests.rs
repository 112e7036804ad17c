//! Targets, one agent's update and the temperature, in cases small enough to check by hand.

use policy::Noise;

use super::*;
use crate::config::{HasacConfig, Rule};
use crate::data::batch::AgentShape;
use crate::sample;

/// The sample's settings with small networks.
fn configs() -> (TrainingConfig, PolicyConfig) {
    let mut config = sample::config();
    (config.critic.width, config.update.learning_rate) = (16, 1e-2);
    config.update.rule = Rule::Hasac;
    let policy = PolicyConfig { width: 16, core: policy::CoreKind::Mlp, ..sample::policy() };
    (config, policy)
}

/// Agents with two observed numbers and one action.
fn problem(agents: usize) -> Problem {
    let usual = sample::problem().agents.remove(0);
    let shape = AgentShape { observation: 2, action: 1, ..usual };
    Problem { agents: vec![shape; agents], state: 3 }
}

fn own(config: &TrainingConfig) -> &HasacConfig {
    config.hasac.as_ref().unwrap()
}

fn noise() -> impl RngCore + Send {
    generator(RunSeed(2), Draw::of(Purpose::UpdateAction))
}

/// The shared signal and the others' precision of independent noise.
const NO_SIGNAL: (&[f32], &[f64]) = (&[], &[]);

fn normals(count: usize) -> Vec<f32> {
    let mut rng = generator(RunSeed(3), Draw::of(Purpose::Probe));
    (0..count).map(|_| policy::standard_normal(&mut rng)).collect()
}

#[test]
fn a_target_is_the_mean_reward_the_smaller_value_and_every_agents_entropy_or_the_reward_alone_at_the_end()
 {
    let next = [[-1.0, 9.0], [4.0, 9.0]].map(|log_prob| {
        let mut drawn = DrawnActions::default();
        drawn.log_prob = log_prob.to_vec();
        drawn
    });
    let (reward, discount) = (vec![vec![1.5, 2.0], vec![0.5, 2.0]], vec![0.9, 0.0]);
    let sample = Sample { reward, discount, ..Sample::default() };
    // The agents' mean reward is 1. 2 - (.5 (-1) + .25 * 4) = 1.5, and 1 + .9 * 1.5 = 2.35; the second step terminates.
    let found = targets(&sample, [&[3.0, f32::NAN], &[2.0, 1.0]], &next, &[0.5, 0.25]);
    assert!((found[0] - 2.35).abs() < 1e-12 && found[1] == 2.0, "{found:?}");
}

#[test]
fn with_one_agent_the_sequential_update_is_that_of_soft_actor_critic() {
    let (config, policy) = configs();
    let hasac = || Hasac::new(&config, &policy, &problem(1), RunSeed(0)).unwrap();
    let (mut sequential, mut plain) = (hasac(), hasac());
    let mut sample = Sample::default();
    sample.now.state = normals(30);
    sample.now.observation = vec![normals(20)];
    sequential.improve_policies(&sample, &[0], &[], &mut [noise()]).unwrap();
    let mut noise = noise();
    let (agent, observation) = (&mut plain.agents[0], &sample.now.observation[0]);
    agent.act(observation, &[], &mut noise).unwrap();
    let drawn = agent.act_in_training(observation, &[], &mut noise).unwrap();
    let input = plain.critics.joint_input(&sample.now.state, &[&drawn.action]);
    let (values, by_input) = plain.critics.frozen().unwrap().smaller(&input);
    // State features, then the action.
    let by_action: Vec<f32> = by_input.chunks_exact(4).map(|row| row[3]).collect();
    agent.improve(&drawn, (&values, &by_action), NO_SIGNAL).unwrap();
    assert_eq!(sequential.arrays().unwrap(), plain.arrays().unwrap());
    assert_ne!(plain.arrays().unwrap(), hasac().arrays().unwrap());
}

#[test]
fn noise_with_constant_loadings_is_that_of_acting_only() {
    let (config, independent) = configs();
    let noise = Some(Noise::Shared);
    let shared = PolicyConfig { noise, noise_loading: Some(0.7), ..independent.clone() };
    let [shared, independent] = [shared, independent].map(|policy| {
        let mut hasac = Hasac::new(&config, &policy, &problem(2), RunSeed(0)).unwrap();
        let mut sample = Sample::default();
        sample.now.state = normals(30);
        sample.now.observation = vec![normals(20); 2];
        let noise = &mut [self::noise(), self::noise()];
        hasac.improve_policies(&sample, &[0, 1], &[], noise).unwrap();
        hasac.scale_noise(0.5);
        let policies = vec![PolicyMetrics::default(); 2];
        let sums = Sums { critics: CriticMetrics::default(), policy_steps: 0, policies };
        let report = hasac.report(1, &sums, &[None; 2]).unwrap();
        let noise = hasac.agents[1].policy().unwrap().head().shared_noise();
        let loading = report.into_iter().find(|(name, _)| name == "agent1/noise_loading");
        let noise = noise.map(|noise| (noise.loading, noise.share));
        (hasac.arrays().unwrap(), noise, loading.map(|(_, found)| found))
    });
    assert_eq!(shared.0, independent.0);
    assert_eq!((shared.1, independent.1), (Some((Some(0.7), Some(0.5))), None));
    assert!((shared.2.unwrap() - 0.35).abs() < 1e-6 && independent.2.is_none(), "{:?}", shared.2);
}

#[test]
fn an_agent_is_updated_against_the_newest_actions_of_those_before_it() {
    let (config, policy) = configs();
    let mut sample = Sample::default();
    sample.now.state = normals(30);
    sample.now.observation = vec![normals(20); 2];
    let hasac = || Hasac::new(&config, &policy, &problem(2), RunSeed(0)).unwrap();
    let (mut sequential, mut plain) = (hasac(), hasac());
    sequential.improve_policies(&sample, &[1, 0], &[], &mut [noise(), noise()]).unwrap();
    let mut critics = plain.critics.frozen().unwrap();
    let mut noise = [noise(), noise()];
    let mut actions = [0, 1].map(|index| {
        let agent: &mut HasacAgent = &mut plain.agents[index];
        agent.act(&sample.now.observation[index], &[], &mut noise[index]).unwrap().action
    });
    for index in [1, 0] {
        let (agent, observation) = (&mut plain.agents[index], &sample.now.observation[index]);
        let drawn = agent.act_in_training(observation, &[], &mut noise[index]).unwrap();
        actions[index].clone_from(&drawn.action);
        let joint = [&actions[0][..], &actions[1][..]];
        let (values, by_input) =
            critics.smaller(&plain.critics.joint_input(&sample.now.state, &joint));
        // State features, then the action of each agent.
        let by_action: Vec<f32> = by_input.chunks_exact(5).map(|row| row[3 + index]).collect();
        agent.improve(&drawn, (&values, &by_action), NO_SIGNAL).unwrap();
        // The second agent meets what the new policy of the first does.
        actions[index] = agent.act(observation, &[], &mut noise[index]).unwrap().action;
    }
    assert_eq!(sequential.arrays().unwrap(), plain.arrays().unwrap());
}

#[test]
fn the_gradient_of_the_smaller_value_is_that_of_one_critic_in_every_row() {
    let (config, policy) = configs();
    let hasac = Hasac::new(&config, &policy, &problem(1), RunSeed(0)).unwrap();
    let mut critics = hasac.critics.frozen().unwrap();
    let start = normals(40);
    let (values, gradient) = critics.smaller(&start);
    for row in 0..10 {
        let value = |by: f32, critics: &mut critics::FrozenCritics| {
            let mut own = start[row * 4..(row + 1) * 4].to_vec();
            own[3] += by;
            (f64::from(own[3]), critics.smaller(&own).0[0])
        };
        let (above, below) = (value(1e-3, &mut critics), value(-1e-3, &mut critics));
        let slope = (above.1 - below.1) / (above.0 - below.0);
        let found = f64::from(gradient[row * 4 + 3]);
        assert!((found - slope).abs() < 2e-2 * (1.0 + slope.abs()), "{row}: {found} {slope}");
        assert!((values[row] - value(0.0, &mut critics).1).abs() < 1e-6);
    }
}

#[test]
fn the_temperature_leads_the_entropy_of_a_bandits_player_to_its_target() {
    let (config, policy) = configs();
    let problem = problem(1);
    let agent = HasacAgent::new((&config, own(&config)), &policy, &problem, RunSeed(0), 0);
    let (mut agent, mut noise) = (agent.unwrap(), noise());
    let observation = normals(128);
    let mut late = 0.0;
    for step in 0..1500 {
        let drawn = agent.act_in_training(&observation, &[], &mut noise).unwrap();
        // The value of an action a is -4 a^2.
        let wide = drawn.action.iter().map(|&a| f64::from(a));
        let values: Vec<f64> = wide.map(|a| -4.0 * a * a).collect();
        let by_action: Vec<f32> = drawn.action.iter().map(|a| -8.0 * a).collect();
        let figures = agent.improve(&drawn, (&values, &by_action), NO_SIGNAL).unwrap();
        late += if step >= 1300 { figures.entropy / 200.0 } else { 0.0 };
    }
    // One action: the target is -1. A Gaussian of this entropy has the variance exp(-3) / (2 pi) = .0079, which is the
    // best one for a temperature of eight times as much.
    assert!((late + 1.0).abs() < 0.1, "entropy {late}");
    let temperature = agent.temperature().unwrap();
    assert!((0.04..0.1).contains(&temperature), "{temperature}");
}

#[test]
fn policies_without_an_optimiser_step_have_no_figures_of_one() {
    let (config, policy) = configs();
    let hasac = Hasac::new(&config, &policy, &problem(1), RunSeed(0)).unwrap();
    let names = |policy_steps: u64| {
        let (critics, policies) = (CriticMetrics::default(), vec![PolicyMetrics::default()]);
        let report = hasac.report(1, &Sums { critics, policy_steps, policies }, &[None]).unwrap();
        let own = report
            .into_iter()
            .filter_map(|(name, _)| name.strip_prefix("agent0/").map(str::to_owned));
        own.collect::<Vec<_>>()
    };
    assert_eq!(names(0), ["temperature", "skipped_steps"]);
    let all = ["policy_loss", "action_value", "entropy", "temperature", "gradient_norm"];
    assert_eq!(names(1), [&all[..], &["skipped_steps"]].concat());
}

/// Two agents that share noise with learnt loadings.
fn correlated(lambda: f64) -> Hasac {
    let (mut config, policy) = configs();
    config.influence = crate::config::InfluenceConfig { lambda, ..config.influence };
    config.update.learning_rate = 1e-2;
    let policy = PolicyConfig { noise: Some(Noise::Shared), noise_loading: None, ..policy };
    Hasac::new(&config, &policy, &problem(2), RunSeed(0)).unwrap()
}

/// Loadings after 300 policy steps in states whose actions have these values, and the last information of agent 0.
fn learnt_loadings(lambda: f64, slope: impl Fn(f32) -> f32) -> ([f64; 2], f64) {
    let mut hasac = correlated(lambda);
    let (observation, mut noise) = (vec![normals(256); 2], [noise(), noise()]);
    let mut information = 0.0;
    for step in 0..300 {
        let [_, signal] = hasac.signals((0, step), 128);
        let actions = hasac.act(&observation, &signal, &mut noise).unwrap();
        for index in [0, 1] {
            let drawn = hasac.agents[index].act_in_training(
                &observation[index],
                &signal,
                &mut noise[index],
            );
            // The value of a pair of actions is `slope(other) own`.
            let by_action: Vec<f32> = actions[1 - index].action.iter().map(|&a| slope(a)).collect();
            let others = hasac.others_precision(index).unwrap();
            let agent = &mut hasac.agents[index];
            let values = (&[0.0; 128][..], &by_action[..]);
            let figures = agent.improve(&drawn.unwrap(), values, (&signal, &others)).unwrap();
            information = if index == 0 { figures.information } else { information };
        }
    }
    let of = |index: usize| hasac.agents[index].loadings().unwrap().values().unwrap()[0];
    ([of(0), of(1)], information)
}

#[test]
fn loadings_rise_where_equal_actions_pay_or_information_has_a_weight_and_not_otherwise() {
    let (indifferent, _) = learnt_loadings(0.0, |_| 0.0);
    assert!(indifferent.iter().all(|r| r.abs() < 0.2), "{indifferent:?}");
    let (paid, _) = learnt_loadings(0.0, |other| 2.0 * other);
    assert!(paid.iter().all(|r| *r > 0.6), "{paid:?}");
    let (informed, information) = learnt_loadings(1.0, |_| 0.0);
    assert!(informed.iter().all(|r| *r > 0.8), "{informed:?}");
    let product = informed[0] * informed[1];
    let closed = -0.5 * libm::log(1.0 - product * product);
    assert!((information - closed).abs() < 0.02 && closed > 0.4, "{information} {closed}");
}

#[test]
fn learnt_loadings_act_as_they_are_trained_and_are_part_of_the_state() {
    let mut hasac = correlated(0.5);
    hasac.scale_noise(0.5);
    let loadings = hasac.agents[1].loadings().unwrap().values().unwrap();
    let policy = hasac.agents[1].policy().unwrap();
    assert!((policy.mean_loading().unwrap() - loadings[0]).abs() < 1e-7, "{loadings:?}");
    assert!((loadings[0] - 0.5 * 0.95 * libm::tanh(0.1)).abs() < 1e-6, "{loadings:?}");
    let names: Vec<String> = hasac.arrays().unwrap().into_keys().collect();
    assert!(names.iter().any(|name| name == "weights/noise_1.loading"), "{names:?}");
    let known = hasac.information(0).unwrap();
    let sums = Sums {
        critics: CriticMetrics::default(),
        policy_steps: 1,
        policies: vec![PolicyMetrics { information: 0.25, ..PolicyMetrics::default() }; 2],
    };
    let report = hasac.report(1, &sums, &[known; 2]).unwrap();
    let of = |name: &str| report.iter().find(|(own, _)| own == name).map(|(_, found)| *found);
    assert_eq!(of("agent0/influence_kl"), Some(0.25));
    assert_eq!(of("agent0/mi_estimate"), known);
    let square = loadings[0] * loadings[0];
    assert!((known.unwrap() + 0.5 * libm::log(1.0 - square * square)).abs() < 1e-9, "{known:?}");
}
