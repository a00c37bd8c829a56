// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Choice} from "../interfaces/IServiceManager.sol";
import {Policy} from "./Policy.sol";

/// @title The service that has waited longest.
contract FirstComeFirstServed is Policy {
    function _choice() internal pure override returns (Choice) {
        return Choice.Oldest;
    }
}
