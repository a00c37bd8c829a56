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
        mapping(uint64 ref => Node) nodes;
    }

    /// @notice The lowest key; 0 if there is none.
    function lowest(Tree storage tree) internal view returns (uint64) {
        uint64 ref = tree.root;
        while (ref != 0 && !_isLeaf(ref)) {
            ref = tree.nodes[ref].left;
        }
        return ref >> 1;
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

    /// @notice The lowest key whose weight has at least this major part; 0 if there is none.
    function first(Tree storage tree, uint64 minMajor) internal view returns (uint64) {
        uint64 ref = tree.root;
        Weight minWeight = weigh(minMajor, 0);
        if (_isLeaf(ref) && tree.rootWeight < minWeight) return 0;
        while (ref != 0 && !_isLeaf(ref)) {
            Node storage node = tree.nodes[ref];
            if (node.leftWeight >= minWeight) ref = node.left;
            else ref = node.rightWeight >= minWeight ? node.right : 0;
        }
        return ref >> 1;
    }

    /// @notice The key up to `maxKey` with the greatest major part; the lowest of equals, 0 if there is none.
    function greatestMajor(Tree storage tree, uint64 maxKey) internal view returns (uint64) {
        return _greatest(tree, maxKey, MAJOR);
    }

    /// @notice The key up to `maxKey` with the greatest minor part; the lowest of equals, 0 if there is none.
    function greatestMinor(Tree storage tree, uint64 maxKey) internal view returns (uint64) {
        return _greatest(tree, maxKey, MINOR);
    }

    /// @notice Add an element, or change the weight of an existing one.
    function put(Tree storage tree, uint64 key, Weight weight) internal {
        uint64 leaf = (key << 1) | 1;
        uint64 root = tree.root;
        (uint64 top, Weight topWeight) =
            root == 0 ? (leaf, weight) : _put(tree, root, _rootWeight(tree), leaf, weight);
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

    function _rootWeight(Tree storage tree) private view returns (Weight) {
        if (_isLeaf(tree.root)) return tree.rootWeight;
        Node storage node = tree.nodes[tree.root];
        return _max(node.leftWeight, node.rightWeight);
    }

    /// @dev Walk down the border of the range and collect the subtrees inside it; then walk down the best one.
    function _greatest(Tree storage tree, uint64 maxKey, Weight part) private view returns (uint64) {
        (uint64 ref, Weight weight) = (tree.root, _rootWeight(tree));
        if (ref == 0) return 0;
        uint64 bound = (maxKey << 1) | 1;
        (uint64 best, Weight greatest) = (0, NO_WEIGHT);
        while (true) {
            if (_last(ref) <= bound) {
                if (best == 0 || weight & part > greatest) (best, greatest) = (ref, weight & part);
                break;
            }
            if (_isLeaf(ref)) break;
            Node storage node = tree.nodes[ref];
            if (bound < ref) {
                (ref, weight) = (node.left, node.leftWeight);
            } else {
                (uint64 left, Weight leftWeight) = (node.left, node.leftWeight & part);
                if (best == 0 || leftWeight > greatest) (best, greatest) = (left, leftWeight);
                (ref, weight) = (node.right, node.rightWeight);
            }
        }
        while (best != 0 && !_isLeaf(best)) {
            Node storage node = tree.nodes[best];
            best = node.leftWeight & part == greatest ? node.left : node.right;
        }
        return best >> 1;
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
