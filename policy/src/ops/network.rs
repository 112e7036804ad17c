//! A whole network as one node of the graph.

use std::cell::RefCell;
use std::sync::{Arc, Mutex, PoisonError};

use candle_core::backprop::GradStore;
use candle_core::{
    CpuStorage, CustomOp2, DType, Layout, Result, Shape, Tensor, TensorId, Var, WithDType,
};
use kernels::{Input, Network, Packed, SequenceLayout, Workspace};
use rand::RngCore;

use super::operand;
use crate::error::PolicyError;
use crate::layers::{LayerSpec, network_of};
use crate::parameters::Parameters;

/// Layers whose trainable parameters are one flat variable.
#[derive(Clone, Debug)]
pub struct LayerStack {
    network: Network,
    flat: Var,
}

/// The current weights of a [`LayerStack`], packed for computation. Created once per optimiser step.
#[derive(Clone, Debug)]
pub struct Weights {
    flat: Tensor,
    packed: Arc<Packed>,
}

/// States and resets of a recurrent network, rows `t * B + b`.
#[derive(Clone, Copy, Debug)]
pub struct RecurrentInput<'a> {
    /// Recurrent state before the first step, `[B, H]`; a constant.
    pub start: &'a Tensor,
    /// 0 where the state is reset before the step, else 1, `[T, B]`.
    pub mask: &'a Tensor,
}

impl LayerStack {
    /// Declares the layers' parameters; their initial values are drawn in order.
    ///
    /// # Errors
    /// If a name is already declared; passes on a tensor error.
    pub fn declare(
        parameters: &mut Parameters,
        specs: &[LayerSpec],
        rng: &mut impl RngCore,
    ) -> core::result::Result<Self, PolicyError> {
        let start: Vec<f32> = specs.iter().flat_map(|spec| spec.initial_values(rng)).collect();
        let named = specs.iter().flat_map(LayerSpec::parameters).collect();
        let flat = parameters.add_all(named, start)?;
        Ok(Self { network: network_of(specs), flat })
    }

    /// The current weights, differentiable.
    ///
    /// # Errors
    /// Passes on a tensor error.
    pub fn weights(&self) -> Result<Weights> {
        weights_of(&self.network, self.flat.as_tensor().clone())
    }

    /// As [`LayerStack::weights`], but constant.
    ///
    /// # Errors
    /// Passes on a tensor error.
    pub fn constant_weights(&self) -> Result<Weights> {
        weights_of(&self.network, self.flat.as_tensor().detach())
    }

    /// As [`LayerStack::weights`], separately for all layers but the last and for the last, for networks that share the
    /// former. There must be at least two layers.
    ///
    /// # Errors
    /// Passes on a tensor error.
    pub fn split_weights(&self) -> Result<[Weights; 2]> {
        let layers = self.network.layers();
        let (trunk, last) = layers.split_at(layers.len() - 1);
        let [trunk, last] = [trunk, last].map(|part| Network::new(part.to_vec()));
        let first = trunk.parameters();
        let of_last = self.flat.narrow(0, first, last.parameters())?;
        Ok([weights_of(&trunk, self.flat.narrow(0, 0, first)?)?, weights_of(&last, of_last)?])
    }
}

fn weights_of(network: &Network, flat: Tensor) -> Result<Weights> {
    let packed = Arc::new(Packed::new(network, &values(&flat)?));
    Ok(Weights { flat, packed })
}

/// The elements of `tensor`, row-major.
fn values(tensor: &Tensor) -> Result<Vec<f32>> {
    tensor.flatten_all()?.to_vec1::<f32>()
}

impl Weights {
    /// The network's output `[R, out]` for rows `x` `[R, in]`.
    ///
    /// # Errors
    /// If shapes or element types do not match.
    pub fn apply(&self, x: &Tensor, recurrent: Option<RecurrentInput<'_>>) -> Result<Tensor> {
        let x = &x.contiguous()?;
        x.apply_op2(&self.flat, Fused::new(&self.packed, x, recurrent)?)
    }

    /// The input of the last layer, `[R, F]`, and the output, `[R, out]`; both constant.
    ///
    /// # Errors
    /// If shapes or element types do not match.
    pub(crate) fn features_and_output(
        &self,
        x: &Tensor,
        recurrent: Option<RecurrentInput<'_>>,
    ) -> Result<(Tensor, Tensor)> {
        let rows = x.dim(0)?;
        let layers = self.packed.network().layers();
        let width = layers[layers.len() - 1].inputs();
        self.constants(x, recurrent, (rows, width), Workspace::append_features)
    }

    /// The recurrent state after every row, `[R, H]`, and the output, `[R, out]`; both constant.
    ///
    /// # Errors
    /// If the network has no GRU; if shapes or element types do not match.
    pub fn states_and_output(
        &self,
        x: &Tensor,
        recurrent: RecurrentInput<'_>,
    ) -> Result<(Tensor, Tensor)> {
        let Some((gru, hidden)) = self.packed.network().gru() else {
            candle_core::bail!("a network without a GRU has no states")
        };
        let states =
            |workspace: &Workspace, into: &mut Vec<f32>| workspace.append_states(gru, into);
        self.constants(x, Some(recurrent), (x.dim(0)?, hidden), states)
    }

    /// A forward pass without a graph: what `append` reads from the workspace, of the given shape, and the output,
    /// `[R, out]`.
    fn constants(
        &self,
        x: &Tensor,
        recurrent: Option<RecurrentInput<'_>>,
        shape: (usize, usize),
        append: impl FnOnce(&Workspace, &mut Vec<f32>),
    ) -> Result<(Tensor, Tensor)> {
        let op = Fused::new(&self.packed, x, recurrent)?;
        let rows = x.dim(0)?;
        let input = values(x)?;
        let mut workspace = take_workspace();
        op.forward(&input, &mut workspace);
        let (mut found, mut output) = (Vec::new(), Vec::new());
        append(&workspace, &mut found);
        workspace.append_output(&mut output);
        return_workspace(workspace);
        let outputs = self.packed.network().outputs();
        let output = Tensor::from_vec(output, (rows, outputs), x.device())?;
        Ok((Tensor::from_vec(found, shape, x.device())?, output))
    }
}

thread_local! {
    /// Unused buffers of this thread.
    static POOL: RefCell<Vec<Workspace>> = const { RefCell::new(Vec::new()) };
    /// Gradients of flat variables that the current backward pass of this thread has accumulated.
    static GRADIENTS: RefCell<Vec<(TensorId, Vec<f32>)>> = const { RefCell::new(Vec::new()) };
}

/// Gradients of a scalar with respect to all variables it depends on.
///
/// The gradients of a fused network's parameters bypass candle's store, which would copy them three times.
pub struct Backward {
    store: GradStore,
    fused: Vec<(TensorId, Vec<f32>)>,
}

impl Backward {
    /// The backward pass from `root`.
    ///
    /// # Errors
    /// Passes on a tensor error.
    pub fn from(root: &Tensor) -> Result<Self> {
        // A thread that waits within one pass may start another: each pass has separate gradients.
        let outer = GRADIENTS.take();
        let store = root.backward();
        let fused = GRADIENTS.replace(outer);
        Ok(Self { store: store?, fused })
    }

    /// The gradient with respect to `variable`, if the root depends on it.
    ///
    /// # Errors
    /// Passes on a tensor error.
    pub fn by(&self, variable: &Tensor) -> Result<Option<Tensor>> {
        let fused = self.fused.iter().find(|(id, _)| *id == variable.id());
        let fused =
            fused.map(|(_, data)| Tensor::from_slice(data, variable.shape(), variable.device()));
        Ok(fused.transpose()?.or_else(|| self.store.get(variable).cloned()))
    }

    /// Removes and returns the gradient of `variable` if it holds the parameters of a fused network.
    pub fn take_fused(&mut self, variable: &Tensor) -> Option<Vec<f32>> {
        let place = self.fused.iter().position(|(id, _)| *id == variable.id())?;
        Some(self.fused.swap_remove(place).1)
    }
}

/// Removes and returns the gradient of `variable` accumulated by this thread, or zeros.
fn take_gradient(variable: &Tensor) -> Vec<f32> {
    let found = GRADIENTS.with_borrow_mut(|found| {
        let place = found.iter().position(|(id, _)| *id == variable.id())?;
        Some(found.swap_remove(place).1)
    });
    found.unwrap_or_else(|| vec![0.0; variable.elem_count()])
}

fn take_workspace() -> Workspace {
    POOL.with_borrow_mut(Vec::pop).unwrap_or_default()
}

fn return_workspace(workspace: Workspace) {
    POOL.with_borrow_mut(|idle| idle.push(workspace));
}

/// A network's forward pass and its backward pass.
struct Fused {
    packed: Arc<Packed>,
    recurrent: Option<Recurrent>,
    /// Saved by the forward pass for the backward pass.
    workspace: Mutex<Option<Workspace>>,
}

struct Recurrent {
    start: Vec<f32>,
    mask: Vec<f32>,
    sequences: usize,
}

impl Drop for Fused {
    fn drop(&mut self) {
        let kept = self.workspace.get_mut().unwrap_or_else(PoisonError::into_inner).take();
        kept.into_iter().for_each(return_workspace);
    }
}

impl Fused {
    fn new(
        packed: &Arc<Packed>,
        x: &Tensor,
        recurrent: Option<RecurrentInput<'_>>,
    ) -> Result<Self> {
        let (rows, width) = x.dims2()?;
        let network = packed.network();
        if width != network.inputs() || x.dtype() != DType::F32 {
            let expected = network.inputs();
            candle_core::bail!(
                "the network expects rows of {expected} f32 values: x is {:?}",
                x.layout()
            )
        }
        let recurrent = match (network.gru(), recurrent) {
            (Some((_, hidden)), Some(given)) => {
                let ((steps, sequences), state) = (given.mask.dims2()?, given.start.dims2()?);
                if state != (sequences, hidden) || steps * sequences != rows {
                    let mask = (steps, sequences);
                    candle_core::bail!("{rows} rows with states {state:?} and a mask {mask:?}")
                }
                let (start, mask) = (values(given.start)?, values(given.mask)?);
                Some(Recurrent { start, mask, sequences })
            }
            (Some(_), None) => candle_core::bail!("a recurrent network needs states and a mask"),
            (None, _) => None,
        };
        Ok(Self { packed: Arc::clone(packed), recurrent, workspace: Mutex::default() })
    }

    fn sequences(&self) -> Option<SequenceLayout<'_>> {
        self.recurrent.as_ref().map(|Recurrent { start, mask, sequences }| SequenceLayout {
            start,
            mask,
            count: *sequences,
        })
    }

    fn forward(&self, rows: &[f32], workspace: &mut Workspace) {
        self.packed.forward(Input { rows, sequences: self.sequences() }, workspace);
    }
}

impl CustomOp2 for Fused {
    fn name(&self) -> &'static str {
        "network"
    }

    fn cpu_fwd(
        &self,
        x: &CpuStorage,
        x_layout: &Layout,
        _flat: &CpuStorage,
        _flat_layout: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        let (rows, _) = x_layout.shape().dims2()?;
        let mut workspace = take_workspace();
        self.forward(operand(x, x_layout)?, &mut workspace);
        let mut output = Vec::with_capacity(rows * self.packed.network().outputs());
        workspace.append_output(&mut output);
        *self.workspace.lock().unwrap_or_else(PoisonError::into_inner) = Some(workspace);
        let shape = Shape::from((rows, self.packed.network().outputs()));
        Ok((f32::to_cpu_storage_owned(output), shape))
    }

    fn bwd(
        &self,
        x: &Tensor,
        flat: &Tensor,
        _y: &Tensor,
        g: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>)> {
        let kept = self.workspace.lock().unwrap_or_else(PoisonError::into_inner).take();
        let Some(mut workspace) = kept else {
            candle_core::bail!("a second backward pass over one forward pass")
        };
        let mut by_flat = flat.track_op().then(|| take_gradient(flat));
        let mut by_x = x.track_op().then(Vec::new);
        let (parameters, input) = (by_flat.as_deref_mut(), by_x.as_mut());
        self.packed.backward(&values(g)?, self.sequences(), &mut workspace, parameters, input);
        return_workspace(workspace);
        let by_x = by_x.map(|data| Tensor::from_vec(data, x.shape(), x.device())).transpose()?;
        let Some(data) = by_flat else { return Ok((by_x, None)) };
        if flat.is_variable() {
            GRADIENTS.with_borrow_mut(|found| found.push((flat.id(), data)));
            return Ok((by_x, None));
        }
        Ok((by_x, Some(Tensor::from_vec(data, flat.shape(), flat.device())?)))
    }
}
