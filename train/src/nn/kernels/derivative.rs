//! The kernels under automatic derivatives.

use burn_autodiff::{
    Autodiff, NodeId,
    checkpoint::{base::Checkpointer, strategy::CheckpointStrategy},
    grads::Gradients,
    ops::{Backward, Ops, OpsKind},
};
use burn_tensor::{Tensor as Device, TensorPrimitive, backend::Backend};

use super::{Convolution, Kernels};

impl<B: Kernels, C: CheckpointStrategy> Kernels for Autodiff<B, C> {
    fn convolve(
        plan: Convolution,
        input: Device<Self, 3>,
        weight: Device<Self, 1>,
        bias: Device<Self, 1>,
    ) -> Device<Self, 3> {
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
        let output = output.into_primitive().tensor();
        let nodes = [input.node, weight.node, bias.node];
        let ready = Convolve.prepare::<C>(nodes).compute_bound().stateful();
        let tracked = match ready {
            OpsKind::Tracked(ready) => {
                let state = Remembered {
                    plan,
                    input: input.primitive,
                    weight: weight.primitive,
                };
                ready.finish(state, output)
            }
            OpsKind::UnTracked(ready) => ready.finish(output),
        };
        Device::from_primitive(TensorPrimitive::Float(tracked))
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
        let Remembered {
            plan,
            input,
            weight,
        } = ops.state;
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
    gradient: Device<B, D>,
) {
    if let Some(node) = node {
        gradients.register::<B>(node, gradient.into_primitive().tensor());
    }
}

fn wrap<B: Backend, const D: usize>(primitive: B::FloatTensorPrimitive) -> Device<B, D> {
    Device::from_primitive(TensorPrimitive::Float(primitive))
}
