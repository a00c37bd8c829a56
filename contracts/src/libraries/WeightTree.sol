// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {MAJOR, MINOR, NO_WEIGHT, Weight, weigh} from "../types/Weight.sol";

/// @title An ordered map from keys to weights that finds the best key of a range.
/// @notice Keys are 1 .. 2^63 - 1. A weight has two parts, `weigh(major, minor)`, which are compared
/// separately. Every operation takes O(log n) of the elements that are in the tree *now*, whatever its history.
/// @dev A crit-bit tree (Bernstein, https://cr.yp.to/critbit.html) in which every node knows the greatest major
/// and the greatest minor part below each child. A reference is a number: leaf `2 * key + 1`, inner node the
/// middle of the range it spans (common prefix, a one, zeros), so that the lowest set bit gives a node's span and
/// a comparison of two references gives left and right. An inner node is one storage word; leaves are stored in
/// their parent's word. Depth is at most 63, and log2(n) for keys that are counted up.
library WeightTree {
    error KeyMissing(uint64 key);

    /// @dev An inner node's word: a reference and the greatest parts of the weights below it, per child.
    struct Node {
        uint64 left;
        Weight leftWeight;
        uint64 right;
        Weight rightWeight;
    }

    struct Tree {
        uint64 root;
        /// @dev Of a key that is alone. Others' weights are in the nodes above them.
        Weight rootWeight;
        /// @dev Keeps the word of an empty tree.
        bool used;
        /// @dev For who has the tree: there is something else beside it. Known here, because the word is read anyway.
        bool marked;
        mapping(uint64 ref => Node) nodes;
    }

    /// @notice Whether there is one key only.
    function isAlone(Tree storage tree) internal view returns (bool) {
        return _isLeaf(tree.root);
    }

    /// @notice Whether no other key has a greater major part than this weight, which the key is to have.
    function leads(Tree storage tree, uint64 key, Weight weight) internal view returns (bool) {
        uint64 leaf = (key << 1) | 1;
        uint64 ref = tree.root;
        while (!_isLeaf(ref)) {
            Node storage node = tree.nodes[ref];
            (uint64 next, Weight rival) =
                leaf < ref ? (node.left, node.rightWeight) : (node.right, node.leftWeight);
            if (rival.majorOf() > weight.majorOf()) return false;
            ref = next;
        }
        return true;
    }

    /// @notice The lowest key from `minKey` on whose weight has at least this major part; 0 if there is none.
    function first(Tree storage tree, uint64 minMajor, uint64 minKey) internal view returns (uint64) {
        uint64 root = tree.root;
        if (root == 0) return 0;
        return _first(tree, root, _rootWeight(tree, root), weigh(minMajor, 0), (minKey << 1) | 1) >> 1;
    }

    /// @notice The key up to `maxKey` with the greatest major part; the lowest of equals, 0 if there is none.
    /// @param skipped keys that it must not be, 64 bits each, 0 for none
    function greatestMajor(Tree storage tree, uint64 maxKey, uint256 skipped) internal view returns (uint64) {
        return _greatest(tree, maxKey, MAJOR, skipped);
    }

    /// @notice The same for the minor part.
    function greatestMinor(Tree storage tree, uint64 maxKey, uint256 skipped) internal view returns (uint64) {
        return _greatest(tree, maxKey, MINOR, skipped);
    }

    /// @notice Add an element, or change the weight of an existing one.
    function put(Tree storage tree, uint64 key, Weight weight) internal {
        uint64 leaf = (key << 1) | 1;
        uint64 root = tree.root;
        (uint64 top, Weight topWeight) =
            root == 0 ? (leaf, weight) : _put(tree, root, _rootWeight(tree, root), leaf, weight);
        _setRoot(tree, top, topWeight);
    }

    /// @notice Remove an element. Reverts with KeyMissing.
    function remove(Tree storage tree, uint64 key) internal {
        if (tree.root == 0) revert KeyMissing(key);
        (uint64 top, Weight topWeight) = _remove(tree, tree.root, (key << 1) | 1);
        _setRoot(tree, top, topWeight);
    }

    function _setRoot(Tree storage tree, uint64 root, Weight weight) private {
        if (root == tree.root && !_isLeaf(root)) return;
        (tree.root, tree.rootWeight, tree.used) = (root, weight, true);
    }

    function _rootWeight(Tree storage tree, uint64 root) private view returns (Weight) {
        if (_isLeaf(root)) return tree.rootWeight;
        Node storage node = tree.nodes[root];
        return _max(node.leftWeight, node.rightWeight);
    }

    /// @dev Below `ref`, the first leaf from `minLeaf` on with at least this weight. Only on the way to `minLeaf` a part of the
    /// tree may have such a weight and no such leaf, so that one way is walked up again at most.
    function _first(Tree storage tree, uint64 ref, Weight weight, Weight minWeight, uint64 minLeaf)
        private
        view
        returns (uint64 leaf)
    {
        if (weight < minWeight || _last(ref) < minLeaf) return 0;
        if (_isLeaf(ref)) return ref;
        Node storage node = tree.nodes[ref];
        if (minLeaf < ref) leaf = _first(tree, node.left, node.leftWeight, minWeight, minLeaf);
        if (leaf == 0) leaf = _first(tree, node.right, node.rightWeight, minWeight, minLeaf);
    }

    /// @dev Find the best part of the tree that is inside the range as a whole; then walk down to its best leaf.
    function _greatest(Tree storage tree, uint64 maxKey, Weight part, uint256 skipped)
        private
        view
        returns (uint64)
    {
        uint64 root = tree.root;
        if (root == 0) return 0;
        (uint64 best, Weight greatest) =
            _inside(tree, root, _rootWeight(tree, root) & part, (maxKey << 1) | 1, part, skipped);
        while (best != 0 && !_isLeaf(best)) {
            Node storage node = tree.nodes[best];
            best = node.leftWeight & part == greatest ? node.left : node.right;
        }
        return best >> 1;
    }

    /// @dev Below `ref`, the part with the greatest weight that has no leaf beyond `bound` and none that is skipped; the
    /// lowest of equals. Only the ways to these leaves are walked.
    function _inside(Tree storage tree, uint64 ref, Weight weight, uint64 bound, Weight part, uint256 skipped)
        private
        view
        returns (uint64 best, Weight greatest)
    {
        if (_last(ref) <= bound && !_spansAny(ref, skipped)) return (ref, weight);
        if (_isLeaf(ref)) return (0, NO_WEIGHT);
        Node storage node = tree.nodes[ref];
        (best, greatest) = _inside(tree, node.left, node.leftWeight & part, bound, part, skipped);
        if (bound < ref) return (best, greatest);
        (uint64 right, Weight rightGreatest) =
            _inside(tree, node.right, node.rightWeight & part, bound, part, skipped);
        if (best == 0 || rightGreatest > greatest) return (right, rightGreatest);
    }

    /// @dev Whether one of these keys is below `ref`, or is `ref`.
    function _spansAny(uint64 ref, uint256 keys) private pure returns (bool) {
        for (; keys != 0; keys >>= 64) {
            uint64 leaf = (uint64(keys) << 1) | 1;
            if (ref == leaf || (!_isLeaf(ref) && _spans(ref, leaf))) return true;
        }
        return false;
    }

    /// @dev Insert or change below `ref`. Returns the new reference in its place, and the greatest weight there.
    function _put(Tree storage tree, uint64 ref, Weight refWeight, uint64 leaf, Weight weight)
        private
        returns (uint64, Weight)
    {
        if (ref == leaf) return (ref, weight);
        if (!_spans(ref, leaf)) {
            uint64 join = _join(ref, leaf);
            tree.nodes[join] =
                leaf < ref ? Node(leaf, weight, ref, refWeight) : Node(ref, refWeight, leaf, weight);
            return (join, _max(weight, refWeight));
        }
        Node memory node = tree.nodes[ref];
        if (leaf < ref) {
            (uint64 left, Weight leftWeight) = _put(tree, node.left, node.leftWeight, leaf, weight);
            if (left != node.left || leftWeight != node.leftWeight) {
                (node.left, node.leftWeight) = (left, leftWeight);
                tree.nodes[ref] = node;
            }
        } else {
            (uint64 right, Weight rightWeight) = _put(tree, node.right, node.rightWeight, leaf, weight);
            if (right != node.right || rightWeight != node.rightWeight) {
                (node.right, node.rightWeight) = (right, rightWeight);
                tree.nodes[ref] = node;
            }
        }
        return (ref, _max(node.leftWeight, node.rightWeight));
    }

    /// @dev Remove below `ref`. Returns the new reference in its place (0 for none), and the greatest weight there.
    function _remove(Tree storage tree, uint64 ref, uint64 leaf) private returns (uint64, Weight) {
        if (ref == leaf) return (0, NO_WEIGHT);
        if (_isLeaf(ref) || !_spans(ref, leaf)) revert KeyMissing(leaf >> 1);
        Node memory node = tree.nodes[ref];
        (uint64 child, Weight weight) = _remove(tree, leaf < ref ? node.left : node.right, leaf);
        if (child == 0) {
            // Its word stays, for the next node at this place.
            return leaf < ref ? (node.right, node.rightWeight) : (node.left, node.leftWeight);
        }
        if (leaf < ref) {
            if (child != node.left || weight != node.leftWeight) {
                (node.left, node.leftWeight) = (child, weight);
                tree.nodes[ref] = node;
            }
        } else if (child != node.right || weight != node.rightWeight) {
            (node.right, node.rightWeight) = (child, weight);
            tree.nodes[ref] = node;
        }
        return (ref, _max(node.leftWeight, node.rightWeight));
    }

    /// @dev The greater of both major parts with the greater of both minor parts.
    function _max(Weight a, Weight b) private pure returns (Weight) {
        (Weight major, Weight minor) = (a > b ? a : b, a & MINOR);
        if (b & MINOR > minor) minor = b & MINOR;
        return (major & MAJOR) | minor;
    }

    function _isLeaf(uint64 ref) private pure returns (bool) {
        return ref & 1 == 1;
    }

    /// @dev The greatest leaf that can be below `ref`; for a leaf, the leaf itself.
    function _last(uint64 ref) private pure returns (uint64) {
        return ref | (ref - 1);
    }

    /// @dev Whether `leaf` is in the range of `ref`: they are equal above the lowest set bit of `ref`.
    function _spans(uint64 ref, uint64 leaf) private pure returns (bool) {
        unchecked {
            uint64 lowestBit = ref & (~ref + 1);
            return (ref ^ leaf) <= (lowestBit | (lowestBit - 1));
        }
    }

    /// @dev The inner node whose left and right ranges contain `a` and `b`: their common prefix, a one, zeros.
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
