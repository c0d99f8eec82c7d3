//! The kernels under automatic derivatives.

use burn_autodiff::{
    Autodiff, NodeId,
    checkpoint::{base::Checkpointer, strategy::CheckpointStrategy},
    grads::Gradients,
    ops::{Backward, Ops, OpsKind},
};
use burn_backend::backend::BackendTypes;
use burn_tensor::{Tensor, TensorPrimitive, backend::Backend};

use crate::{Affine, AttentionInputs, Convolution, Kernels, Queries};

impl<B: Kernels, C: CheckpointStrategy> Kernels for Autodiff<B, C> {
    fn convolve(plan: Convolution, affine: Affine<Self>) -> Tensor<Self, 3> {
        let parts = parts(affine);
        let affine = untracked::<B, C>(&parts);
        let nodes = parts.map(|part| part.node);
        let output = B::convolve(plan, affine.clone());
        let ready = Convolve.prepare::<C>(nodes).compute_bound().stateful();
        finished(ready, (plan, affine), output)
    }

    fn activate(input: Tensor<Self, 3>) -> Tensor<Self, 3> {
        let input = recorded(input);
        let (input, node) = (wrap(input.primitive), input.node);
        let output = B::activate(Tensor::clone(&input));
        let ready = Activate.prepare::<C>([node]).compute_bound().stateful();
        finished(ready, input, output)
    }

    fn normalise(affine: Affine<Self>) -> Tensor<Self, 3> {
        let parts = parts(affine);
        let affine = untracked::<B, C>(&parts);
        let nodes = parts.map(|part| part.node);
        let output = B::normalise(affine.clone());
        let ready = Normalise.prepare::<C>(nodes).compute_bound().stateful();
        finished(ready, affine, output)
    }

    fn attend(inputs: AttentionInputs<Self>) -> Tensor<Self, 3> {
        let AttentionInputs { heads, queries, forbidden, kept } = inputs;
        let parts = [queries.query, queries.key, queries.value].map(recorded);
        let [query, key, value] = parts.each_ref().map(|part| wrap(part.primitive.clone()));
        let inputs = AttentionInputs {
            heads,
            queries: Queries { query, key, value },
            forbidden: Tensor::from_primitive(forbidden.into_primitive()),
            kept: kept.map(Tensor::inner),
        };
        let output = B::attend(inputs.clone());
        let nodes = parts.map(|part| part.node);
        let ready = Attend.prepare::<C>(nodes).compute_bound().stateful();
        finished(ready, inputs, output)
    }

    fn kept<const D: usize>(like: &Tensor<Self, D>, share: f64) -> Tensor<Self, D> {
        Tensor::from_inner(B::kept(&like.clone().inner(), share))
    }
}

type Recorded<B, C> = <Autodiff<B, C> as BackendTypes>::FloatTensorPrimitive;

/// A tensor's values and its place in the graph of derivatives.
fn recorded<B: Kernels, C: CheckpointStrategy, const D: usize>(
    tensor: Tensor<Autodiff<B, C>, D>,
) -> Recorded<B, C> {
    tensor.into_primitive().tensor()
}

fn parts<B: Kernels, C: CheckpointStrategy>(affine: Affine<Autodiff<B, C>>) -> [Recorded<B, C>; 3] {
    [recorded(affine.input), recorded(affine.weight), recorded(affine.bias)]
}

fn untracked<B: Kernels, C: CheckpointStrategy>(parts: &[Recorded<B, C>; 3]) -> Affine<B> {
    let [input, weight, bias] = parts.each_ref().map(|part| part.primitive.clone());
    Affine { input: wrap(input), weight: wrap(weight), bias: wrap(bias) }
}

/// An operation's result, with what its derivative needs where that is wanted.
fn finished<O, B, S, C, const N: usize>(
    ready: OpsKind<O, B, S, C, N>,
    state: S,
    output: Tensor<B, 3>,
) -> Tensor<Autodiff<B, C>, 3>
where
    B: Backend,
    C: CheckpointStrategy,
    S: Clone + Send + std::fmt::Debug + 'static,
    O: Backward<B, N, State = S>,
{
    let output = output.into_primitive().tensor();
    let tracked = match ready {
        OpsKind::Tracked(ready) => ready.finish(state, output),
        OpsKind::UnTracked(ready) => ready.finish(output),
    };
    Tensor::from_primitive(TensorPrimitive::Float(tracked))
}

#[derive(Debug)]
struct Activate;

impl<B: Kernels> Backward<B, 1> for Activate {
    type State = Tensor<B, 3>;

    fn backward(
        self,
        ops: Ops<Self::State, 1>,
        gradients: &mut Gradients,
        _checkpointer: &mut Checkpointer,
    ) {
        let outer = gradients.consume::<B>(&ops.node);
        let found = B::activate_backward(ops.state, wrap(outer));
        let [input] = ops.parents.map(|parent| parent.map(|node| node.id));
        register::<B, 3>(gradients, input, found);
    }
}

#[derive(Debug)]
struct Convolve;

impl<B: Kernels> Backward<B, 3> for Convolve {
    type State = (Convolution, Affine<B>);

    fn backward(
        self,
        ops: Ops<Self::State, 3>,
        gradients: &mut Gradients,
        _checkpointer: &mut Checkpointer,
    ) {
        let outer = gradients.consume::<B>(&ops.node);
        let (plan, affine) = ops.state;
        let parents = ops.parents.map(|parent| parent.map(|node| node.id));
        register_affine(gradients, parents, B::convolve_backward(plan, affine, wrap(outer)));
    }
}

#[derive(Debug)]
struct Normalise;

impl<B: Kernels> Backward<B, 3> for Normalise {
    type State = Affine<B>;

    fn backward(
        self,
        ops: Ops<Self::State, 3>,
        gradients: &mut Gradients,
        _checkpointer: &mut Checkpointer,
    ) {
        let outer = gradients.consume::<B>(&ops.node);
        let parents = ops.parents.map(|parent| parent.map(|node| node.id));
        register_affine(gradients, parents, B::normalise_backward(ops.state, wrap(outer)));
    }
}

#[derive(Debug)]
struct Attend;

impl<B: Kernels> Backward<B, 3> for Attend {
    type State = AttentionInputs<B>;

    fn backward(
        self,
        ops: Ops<Self::State, 3>,
        gradients: &mut Gradients,
        _checkpointer: &mut Checkpointer,
    ) {
        let outer = gradients.consume::<B>(&ops.node);
        let found = B::attend_backward(ops.state, wrap(outer));
        let [query, key, value] = ops.parents.map(|parent| parent.map(|node| node.id));
        register::<B, 3>(gradients, query, found.query);
        register::<B, 3>(gradients, key, found.key);
        register::<B, 3>(gradients, value, found.value);
    }
}

fn register_affine<B: Kernels>(
    gradients: &mut Gradients,
    [input, weight, bias]: [Option<NodeId>; 3],
    found: Affine<B>,
) {
    register::<B, 3>(gradients, input, found.input);
    register::<B, 1>(gradients, weight, found.weight);
    register::<B, 1>(gradients, bias, found.bias);
}

fn register<B: Backend, const D: usize>(
    gradients: &mut Gradients,
    node: Option<NodeId>,
    gradient: Tensor<B, D>,
) {
    if let Some(node) = node {
        gradients.register::<B>(node, gradient.into_primitive().tensor());
    }
}

fn wrap<B: Backend, const D: usize>(primitive: B::FloatTensorPrimitive) -> Tensor<B, D> {
    Tensor::from_primitive(TensorPrimitive::Float(primitive))
}
