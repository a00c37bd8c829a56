// SPDX-License-Identifier: MIT
pragma solidity ^0.8.28;

/// @title A queue from which the first element that weighs enough can be taken.
/// @notice Elements are ordered by a key (1 .. 2^63 - 1) and carry a weight. Finding the lowest key whose weight
/// is at least a bound, inserting anywhere and removing anywhere take O(log n) of the elements *now* in the
/// queue's key range, whatever came and went before.
/// @dev A crit-bit tree (Bernstein, https://cr.yp.to/critbit.html) in which every node knows the greatest weight
/// below each child. A reference is a number: leaf `2 * key + 1`, inner node the middle of the range it spans
/// (common prefix, a one, zeros), so that the lowest set bit tells a node's span and comparing two references
/// tells left from right. An inner node is one storage word; leaves live in their parent's word.
library FirstFitQueue {
    error KeyTaken(uint64 key);
    error KeyMissing(uint64 key);

    /// @dev An inner node's word, or the queue's own: a reference and the greatest weight below it, per child.
    struct Node {
        uint64 left;
        uint64 leftWeight;
        uint64 right;
        uint64 rightWeight;
    }

    struct Queue {
        uint64 root;
        uint64 rootWeight;
        /// @dev Not used here: room for the owner to number what it inserts, in a word that is read anyway.
        uint64 serial;
        mapping(uint64 ref => Node) nodes;
    }

    /// @notice The lowest key whose weight is at least `minWeight`; 0 if there is none.
    function first(Queue storage queue, uint64 minWeight) internal view returns (uint64 key) {
        uint64 ref = queue.root;
        if (ref == 0 || queue.rootWeight < minWeight) return 0;
        while (!_isLeaf(ref)) {
            Node storage node = queue.nodes[ref];
            ref = node.leftWeight >= minWeight ? node.left : node.right;
        }
        return ref >> 1;
    }

    /// @notice Add an element. Reverts with KeyTaken.
    function insert(Queue storage queue, uint64 key, uint64 weight) internal {
        uint64 leaf = (key << 1) | 1;
        uint64 root = queue.root;
        (queue.root, queue.rootWeight) =
            root == 0 ? (leaf, weight) : _insert(queue, root, queue.rootWeight, leaf, weight);
    }

    /// @notice Take an element out. Reverts with KeyMissing.
    function remove(Queue storage queue, uint64 key) internal {
        if (queue.root == 0) revert KeyMissing(key);
        (queue.root, queue.rootWeight) = _remove(queue, queue.root, (key << 1) | 1);
    }

    /// @dev Insert below `ref`. Returns what stands in its place now, and the greatest weight there.
    function _insert(Queue storage queue, uint64 ref, uint64 refWeight, uint64 leaf, uint64 weight)
        private
        returns (uint64, uint64)
    {
        uint64 max = weight > refWeight ? weight : refWeight;
        if (ref == leaf) revert KeyTaken(leaf >> 1);
        if (!_spans(ref, leaf)) {
            uint64 join = _join(ref, leaf);
            queue.nodes[join] =
                leaf < ref ? Node(leaf, weight, ref, refWeight) : Node(ref, refWeight, leaf, weight);
            return (join, max);
        }
        Node memory node = queue.nodes[ref];
        if (leaf < ref) {
            (uint64 left, uint64 leftWeight) = _insert(queue, node.left, node.leftWeight, leaf, weight);
            if (left != node.left || leftWeight != node.leftWeight) {
                queue.nodes[ref] = Node(left, leftWeight, node.right, node.rightWeight);
            }
        } else {
            (uint64 right, uint64 rightWeight) = _insert(queue, node.right, node.rightWeight, leaf, weight);
            if (right != node.right || rightWeight != node.rightWeight) {
                queue.nodes[ref] = Node(node.left, node.leftWeight, right, rightWeight);
            }
        }
        return (ref, max);
    }

    /// @dev Remove below `ref`. Returns what stands in its place now (0 for nothing), and the greatest weight there.
    function _remove(Queue storage queue, uint64 ref, uint64 leaf) private returns (uint64, uint64) {
        if (ref == leaf) return (0, 0);
        if (_isLeaf(ref) || !_spans(ref, leaf)) revert KeyMissing(leaf >> 1);
        Node memory node = queue.nodes[ref];
        (uint64 child, uint64 weight) = _remove(queue, leaf < ref ? node.left : node.right, leaf);
        if (child == 0) {
            delete queue.nodes[ref];
            return leaf < ref ? (node.right, node.rightWeight) : (node.left, node.leftWeight);
        }
        Node memory updated = leaf < ref
            ? Node(child, weight, node.right, node.rightWeight)
            : Node(node.left, node.leftWeight, child, weight);
        if (leaf < ref
                ? child != node.left || weight != node.leftWeight
                : child != node.right || weight != node.rightWeight) {
            queue.nodes[ref] = updated;
        }
        return (ref, updated.leftWeight > updated.rightWeight ? updated.leftWeight : updated.rightWeight);
    }

    function _isLeaf(uint64 ref) private pure returns (bool) {
        return ref & 1 == 1;
    }

    /// @dev Whether `leaf` is in the range of `ref`: they differ nowhere above the lowest set bit of `ref`.
    function _spans(uint64 ref, uint64 leaf) private pure returns (bool) {
        unchecked {
            uint64 lowest = ref & (~ref + 1);
            return (ref ^ leaf) <= (lowest | (lowest - 1));
        }
    }

    /// @dev The inner node whose left and right ranges hold `a` and `b`: their common prefix, a one, zeros.
    function _join(uint64 a, uint64 b) private pure returns (uint64) {
        uint64 low = a ^ b;
        low |= low >> 1;
        low |= low >> 2;
        low |= low >> 4;
        low |= low >> 8;
        low |= low >> 16;
        low |= low >> 32;
        // `low` masks the highest differing bit and all below it.
        return (a | low) ^ (low >> 1);
    }
}
