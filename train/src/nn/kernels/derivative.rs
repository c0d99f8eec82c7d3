//! The kernels under automatic derivatives.

use burn_autodiff::{
    Autodiff, NodeId,
    checkpoint::{base::Checkpointer, strategy::CheckpointStrategy},
    grads::Gradients,
    ops::{Backward, Ops, OpsKind},
};
use burn_tensor::{Bool, Tensor, TensorPrimitive, backend::Backend};

use super::{Convolution, Heads, Kernels, Queries};

impl<B: Kernels, C: CheckpointStrategy> Kernels for Autodiff<B, C> {
    fn convolve(
        plan: Convolution,
        input: Tensor<Self, 3>,
        weight: Tensor<Self, 1>,
        bias: Tensor<Self, 1>,
    ) -> Tensor<Self, 3> {
        let [input, weight, bias] = [
            input.into_primitive().tensor(),
            weight.into_primitive().tensor(),
            bias.into_primitive().tensor(),
        ];
        let output = B::convolve(
            plan,
            wrap(input.primitive.clone()),
            wrap(weight.primitive.clone()),
            wrap(bias.primitive),
        );
        let nodes = [input.node, weight.node, bias.node];
        let ready = Convolve.prepare::<C>(nodes).compute_bound().stateful();
        let state = Remembered { plan, input: input.primitive, weight: weight.primitive };
        finished(ready, state, output)
    }

    fn activate(input: Tensor<Self, 3>) -> Tensor<Self, 3> {
        let input = input.into_primitive().tensor();
        let output = B::activate(wrap(input.primitive.clone()));
        let ready = Activate.prepare::<C>([input.node]).compute_bound().stateful();
        finished(ready, input.primitive, output)
    }

    fn normalise(
        input: Tensor<Self, 3>,
        weight: Tensor<Self, 1>,
        bias: Tensor<Self, 1>,
    ) -> Tensor<Self, 3> {
        let [input, weight, bias] = [
            input.into_primitive().tensor(),
            weight.into_primitive().tensor(),
            bias.into_primitive().tensor(),
        ];
        let output = B::normalise(
            wrap(input.primitive.clone()),
            wrap(weight.primitive.clone()),
            wrap(bias.primitive),
        );
        let nodes = [input.node, weight.node, bias.node];
        let ready = Normalise.prepare::<C>(nodes).compute_bound().stateful();
        finished(ready, (input.primitive, weight.primitive), output)
    }

    fn attend(
        heads: Heads,
        queries: Queries<Self>,
        forbidden: Tensor<Self, 2, Bool>,
        kept: Option<Tensor<Self, 4>>,
    ) -> Tensor<Self, 3> {
        let parts = [queries.query, queries.key, queries.value];
        let parts = parts.map(|part| part.into_primitive().tensor());
        let state = Attended {
            heads,
            parts: parts.each_ref().map(|part| part.primitive.clone()),
            forbidden: forbidden.into_primitive(),
            kept: kept.map(|kept| kept.into_primitive().tensor().primitive),
        };
        let output = state.clone().forward::<B>();
        let nodes = parts.map(|part| part.node);
        let ready = Attend.prepare::<C>(nodes).compute_bound().stateful();
        finished(ready, state, output)
    }

    fn kept<const D: usize>(like: &Tensor<Self, D>, share: f64) -> Tensor<Self, D> {
        Tensor::from_inner(B::kept(&like.clone().inner(), share))
    }
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
    type State = B::FloatTensorPrimitive;

    fn backward(
        self,
        ops: Ops<Self::State, 1>,
        gradients: &mut Gradients,
        _checkpointer: &mut Checkpointer,
    ) {
        let outer = gradients.consume::<B>(&ops.node);
        let found = B::activate_backward(wrap(ops.state), wrap(outer));
        let [input] = ops.parents.map(|parent| parent.map(|node| node.id));
        register::<B, 3>(gradients, input, found);
    }
}

#[derive(Debug)]
struct Normalise;

impl<B: Kernels> Backward<B, 3> for Normalise {
    type State = (B::FloatTensorPrimitive, B::FloatTensorPrimitive);

    fn backward(
        self,
        ops: Ops<Self::State, 3>,
        gradients: &mut Gradients,
        _checkpointer: &mut Checkpointer,
    ) {
        let outer = gradients.consume::<B>(&ops.node);
        let (input, weight) = ops.state;
        let found = B::normalise_backward(wrap(input), wrap(weight), wrap(outer));
        let [input, weight, bias] = ops.parents.map(|parent| parent.map(|node| node.id));
        register::<B, 3>(gradients, input, found.input);
        register::<B, 1>(gradients, weight, found.weight);
        register::<B, 1>(gradients, bias, found.bias);
    }
}

#[derive(Debug)]
struct Attend;

/// What the derivative of attention needs.
#[derive(Clone, Debug)]
struct Attended<T, M> {
    heads: Heads,
    parts: [T; 3],
    forbidden: M,
    kept: Option<T>,
}

type AttendedOn<B> = Attended<
    <B as burn_backend::backend::BackendTypes>::FloatTensorPrimitive,
    <B as burn_backend::backend::BackendTypes>::BoolTensorPrimitive,
>;

impl<T, M> Attended<T, M> {
    fn unwrapped<B>(self) -> (Queries<B>, Tensor<B, 2, Bool>, Option<Tensor<B, 4>>)
    where
        B: Kernels<FloatTensorPrimitive = T, BoolTensorPrimitive = M>,
    {
        let [query, key, value] = self.parts.map(|part| wrap(part));
        let queries = Queries { query, key, value };
        let forbidden = Tensor::from_primitive(self.forbidden);
        (queries, forbidden, self.kept.map(|kept| wrap(kept)))
    }

    fn forward<B>(self) -> Tensor<B, 3>
    where
        B: Kernels<FloatTensorPrimitive = T, BoolTensorPrimitive = M>,
    {
        let heads = self.heads;
        let (queries, forbidden, kept) = self.unwrapped();
        B::attend(heads, queries, forbidden, kept)
    }
}

impl<B: Kernels> Backward<B, 3> for Attend {
    type State = AttendedOn<B>;

    fn backward(
        self,
        ops: Ops<Self::State, 3>,
        gradients: &mut Gradients,
        _checkpointer: &mut Checkpointer,
    ) {
        let outer = gradients.consume::<B>(&ops.node);
        let heads = ops.state.heads;
        let (queries, forbidden, kept) = ops.state.unwrapped();
        let found = B::attend_backward(heads, queries, forbidden, kept, wrap(outer));
        let [query, key, value] = ops.parents.map(|parent| parent.map(|node| node.id));
        register::<B, 3>(gradients, query, found.query);
        register::<B, 3>(gradients, key, found.key);
        register::<B, 3>(gradients, value, found.value);
    }
}

#[derive(Debug)]
struct Convolve;

/// What a convolution's derivative needs.
#[derive(Clone, Debug)]
struct Remembered<T> {
    plan: Convolution,
    input: T,
    weight: T,
}

impl<B: Kernels> Backward<B, 3> for Convolve {
    type State = Remembered<B::FloatTensorPrimitive>;

    fn backward(
        self,
        ops: Ops<Self::State, 3>,
        gradients: &mut Gradients,
        _checkpointer: &mut Checkpointer,
    ) {
        let outer = gradients.consume::<B>(&ops.node);
        let Remembered { plan, input, weight } = ops.state;
        let found = B::convolve_backward(plan, wrap(input), wrap(weight), wrap(outer));
        let [input, weight, bias] = ops.parents.map(|parent| parent.map(|node| node.id));
        register::<B, 3>(gradients, input, found.input);
        register::<B, 1>(gradients, weight, found.weight);
        register::<B, 1>(gradients, bias, found.bias);
    }
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
