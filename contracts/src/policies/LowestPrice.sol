// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Choice} from "../interfaces/IServiceManager.sol";
import {Policy} from "./Policy.sol";

/// @title The cheapest service. Among equals the best reputation, then the one that has waited longest.
/// @notice A service is paid what it asks. So it pays a provider to ask as much as the next cheaper one would lose by.
contract LowestPrice is Policy {
    function _choice() internal pure override returns (Choice) {
        return Choice.Cheapest;
    }
}
